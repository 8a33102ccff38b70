// viser's client: it is given the messages that its server would send, and asked what it draws.

const client = () => window.__viserMutable;

// All messages of a moment; the client draws once.
function say(messages) {
  client().messageQueue.push(...messages.map((message) => ({ owner: "", ...message })));
  client().requestRender();
}
const place = (name, position) => ({ type: "SetPositionMessage", name, position });
const turn = (name, wxyz) => ({ type: "SetOrientationMessage", name, wxyz });
const show = (name, visible) => ({ type: "SetSceneNodeVisibilityMessage", name, visible });
const change = (name, updates) => ({ type: "SceneNodeUpdateMessage", name, updates });

// Whether the client has drawn the scene that came with the page.
function ready(nodes) {
  const state = client()?.drainMessageQueue && window.__viserSceneTree?.getState();
  return Boolean(state) && nodes.every((name) => client().nodeRefFromName[name]);
}

// A point, or a vector, moved by a column-major 4 x 4 matrix.
function moved(m, p, w = 1) {
  const row = (r) => m[r] * p[0] + m[r + 4] * p[1] + m[r + 8] * p[2] + m[r + 12] * w;
  const scale = w ? row(3) : 1;
  return [row(0) / scale, row(1) / scale, row(2) / scale];
}
const inverse = (object) => object.matrixWorld.clone().invert().elements;

// The ray of the pointer in the base frame.
function pointed(event) {
  const { camera, canvas, nodeRefFromName } = client();
  const box = canvas.getBoundingClientRect();
  const x = (2 * (event.clientX - box.left)) / box.width - 1;
  const y = 1 - (2 * (event.clientY - box.top)) / box.height;
  const base = inverse(nodeRefFromName["/base"]);
  const [near, far] = [-1, 1].map((z) =>
    moved(base, moved(camera.matrixWorld.elements, moved(camera.projectionMatrixInverse.elements, [x, y, z]))),
  );
  const direction = add(far, near, -1);
  const length = norm(direction);
  return { origin: near, direction: direction.map((value) => value / length) };
}

// Where a point in the base frame is on the screen, in pixels of the browser's window.
function onScreen(point) {
  const { camera, canvas, nodeRefFromName } = client();
  const world = moved(nodeRefFromName["/base"].matrixWorld.elements, point);
  const seen = moved(camera.matrixWorldInverse.elements, world);
  const [x, y] = moved(camera.projectionMatrix.elements, seen);
  const box = canvas.getBoundingClientRect();
  return [box.left + ((x + 1) / 2) * box.width, box.top + ((1 - y) / 2) * box.height];
}

// How far along a ray the first body is, in lengths of its direction; Infinity if there is none.
function hit(origin, direction) {
  const { nodeRefFromName } = client();
  const base = nodeRefFromName["/base"].matrixWorld.elements;
  const [o, d] = [moved(base, origin), moved(base, direction, 0)];
  let nearest = Infinity;
  for (const name of Object.keys(nodeRefFromName)) {
    if (!name.startsWith("/bodies/")) continue;
    nodeRefFromName[name]?.traverse((object) => {
      if (!object.isMesh || !object.geometry?.index) return;
      const m = inverse(object);
      nearest = Math.min(nearest, first(object.geometry, moved(m, o), moved(m, d, 0)));
    });
  }
  return nearest;
}

// Möller and Trumbore's intersection with all triangles of a mesh.
function first(geometry, o, d) {
  const { center, radius } = geometry.boundingSphere ?? (geometry.computeBoundingSphere(), geometry.boundingSphere);
  const away = [o[0] - center.x, o[1] - center.y, o[2] - center.z];
  const along = -dot(away, d) / dot(d, d);
  if (norm(add(away, d, along)) > radius) return Infinity;
  const p = geometry.attributes.position.array;
  const index = geometry.index.array;
  let nearest = Infinity;
  for (let n = 0; n < index.length; n += 3) {
    const [a, b, c] = [3 * index[n], 3 * index[n + 1], 3 * index[n + 2]];
    const [ex, ey, ez] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [fx, fy, fz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    const [hx, hy, hz] = [d[1] * fz - d[2] * fy, d[2] * fx - d[0] * fz, d[0] * fy - d[1] * fx];
    const det = ex * hx + ey * hy + ez * hz;
    if (Math.abs(det) < 1e-14) continue;
    const [sx, sy, sz] = [o[0] - p[a], o[1] - p[a + 1], o[2] - p[a + 2]];
    const u = (sx * hx + sy * hy + sz * hz) / det;
    if (u < 0 || u > 1) continue;
    const [qx, qy, qz] = [sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex];
    const v = (d[0] * qx + d[1] * qy + d[2] * qz) / det;
    if (v < 0 || u + v > 1) continue;
    const t = (fx * qx + fy * qy + fz * qz) / det;
    if (t > 1e-6 && t < nearest) nearest = t;
  }
  return nearest;
}
