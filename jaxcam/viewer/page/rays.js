// Cameras: which way a pixel looks, and where a point is seen. Points are arrays of three numbers
// in the base frame (m); pixels are (u, v), (0.5, 0.5) being the centre of the first.

const floats = (text) =>
  new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const norm = (a) => Math.sqrt(dot(a, a));

// The t-th block of so many numbers; the only one where nothing changes with time.
const block = (array, size, t) => {
  const count = array.length / size;
  const at = Math.min(count - 1, t) * size;
  return array.subarray(at, at + size);
};

class Camera {
  constructor(view) {
    Object.assign(this, view);
    this.K = floats(view.K);
    this.pose = floats(view.pose);
    if (this.lens) this.directions = floats(this.lens.directions);
  }

  centre(t) {
    const p = block(this.pose, 12, t);
    return [p[3], p[7], p[11]];
  }

  // A vector in camera axes in the base's, and back.
  out(v, t) {
    const p = block(this.pose, 12, t);
    return [0, 4, 8].map((r) => p[r] * v[0] + p[r + 1] * v[1] + p[r + 2] * v[2]);
  }
  into(v, t) {
    const p = block(this.pose, 12, t);
    return [0, 1, 2].map((c) => p[c] * v[0] + p[4 + c] * v[1] + p[8 + c] * v[2]);
  }

  normalised(u, v, t) {
    const K = block(this.K, 9, t);
    const y = (v - K[5]) / K[4];
    return [(u - K[2] - K[1] * y) / K[0], y];
  }
  pixelOf(x, y, t) {
    const K = block(this.K, 9, t);
    return [K[0] * x + K[1] * y + K[2], K[4] * y + K[5]];
  }

  // What the lens undoes: (x', y') to the direction (x, y, 1); null where a pixel has no ray.
  looks([x, y]) {
    if (!this.lens) return [x, y];
    const { low, step, size } = this.lens;
    const [a, b] = [(x - low[0]) / step[0], (y - low[1]) / step[1]];
    if (!(a >= -1e-6 && b >= -1e-6 && a <= size - 1 + 1e-6 && b <= size - 1 + 1e-6)) return null;
    const i = Math.max(0, Math.min(size - 2, Math.floor(a)));
    const j = Math.max(0, Math.min(size - 2, Math.floor(b)));
    const [p, q] = [a - i, b - j];
    const g = (r, c, k) => this.directions[2 * (r * size + c) + k];
    const result = [0, 1].map(
      (k) =>
        (1 - q) * ((1 - p) * g(j, i, k) + p * g(j, i + 1, k)) +
        q * ((1 - p) * g(j + 1, i, k) + p * g(j + 1, i + 1, k)),
    );
    return result.every(Number.isFinite) ? result : null;
  }

  // What the lens does: the inverse of `looks`, by Newton's steps from the nearest lattice point.
  bends(target) {
    if (!this.lens) return target;
    const { low, step, size } = this.lens;
    let best = Infinity;
    let at = null;
    for (let n = 0; n < size * size; n++) {
      const distance =
        (this.directions[2 * n] - target[0]) ** 2 + (this.directions[2 * n + 1] - target[1]) ** 2;
      if (distance < best) {
        best = distance;
        at = [low[0] + step[0] * (n % size), low[1] + step[1] * Math.floor(n / size)];
      }
    }
    for (let k = 0; at && k < 12; k++) {
      const here = this.looks(at);
      if (!here) return null;
      const miss = [target[0] - here[0], target[1] - here[1]];
      if (Math.hypot(...miss) < 1e-7) break;
      const inward = [0, 1].map((i) => (at[i] > low[i] + (step[i] * (size - 1)) / 2 ? -1 : 1));
      const h = [inward[0] * step[0] * 0.05, inward[1] * step[1] * 0.05];
      const right = this.looks([at[0] + h[0], at[1]]);
      const below = this.looks([at[0], at[1] + h[1]]);
      if (!right || !below) return null;
      const [a, c] = [(right[0] - here[0]) / h[0], (right[1] - here[1]) / h[0]];
      const [b, d] = [(below[0] - here[0]) / h[1], (below[1] - here[1]) / h[1]];
      const det = a * d - b * c;
      at = [
        at[0] + (d * miss[0] - b * miss[1]) / det,
        at[1] + (a * miss[1] - c * miss[0]) / det,
      ];
    }
    const end = at && this.looks(at);
    return end && Math.hypot(end[0] - target[0], end[1] - target[1]) < 1e-4 ? at : null;
  }

  // The ray of a pixel; its direction has planar depth one. Null where there is none.
  ray(u, v, t) {
    const xy = this.looks(this.normalised(u, v, t));
    return xy && { origin: this.centre(t), direction: this.out([...xy, 1], t) };
  }

  // The pixel of a point; null where it is not in the picture.
  pixel(point, t) {
    const p = this.into(add(point, this.centre(t), -1), t);
    if (p[2] < 1e-6) return null;
    const xy = this.bends([p[0] / p[2], p[1] / p[2]]);
    if (!xy) return null;
    const [u, v] = this.pixelOf(...xy, t);
    return u >= 0 && v >= 0 && u <= this.width && v <= this.height ? [u, v] : null;
  }

  // Where a ray in space meets the shown picture: its pixel, and how far along; null if nowhere.
  met(origin, direction, depth, t) {
    const o = this.into(add(origin, this.centre(t), -1), t);
    const d = this.into(direction, t);
    const s = (depth - o[2]) / d[2];
    if (!(s > 0)) return null;
    const [u, v] = this.pixelOf((o[0] + s * d[0]) / depth, (o[1] + s * d[1]) / depth, t);
    return u >= 0 && v >= 0 && u <= this.width && v <= this.height ? { u, v, s } : null;
  }

  // The last picture at or before a moment; -1 if there is none.
  shown(t) {
    let n = this.steps.length - 1;
    while (n > 0 && this.steps[n] > t) n--;
    return n;
  }
}
