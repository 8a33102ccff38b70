"""openpi's own client, which nobody here wrote, asks our server.

It wants NumPy 1, so it lives in an environment of its own: JAXCAM_OPENPI names its Python, after
`python -m venv ENV && ENV/bin/pip install openpi-client typing_extensions`.
"""

import json
import os
import subprocess

import numpy as np
import pytest
from served_runs import linear_request, linear_service, local_chunks, serving

PYTHON = os.environ.get("JAXCAM_OPENPI", "")
THEIRS = """
import json, sys
import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy
policy = WebsocketClientPolicy("127.0.0.1", int(sys.argv[1]), api_key="sesame")
arrays = dict(np.load(sys.argv[2]))
observation = {name.replace(".", "/"): value for name, value in arrays.items()}
first = policy.infer({**observation, "prompt": "lift it"})
try:
    policy.infer({**observation, "observation/state": np.zeros(4)})
except RuntimeError as error:
    words = str(error)
again = policy.infer(observation)
print(json.dumps({
    "views": policy.get_server_metadata()["views"], "words": words,
    "first": first["actions"].tolist(), "again": again["actions"].tolist(),
}))
"""


@pytest.mark.skipif(not PYTHON, reason="JAXCAM_OPENPI names no Python with openpi-client")
def test_openpis_client_is_answered(tmp_path):
    service, message = linear_service(), linear_request()
    np.savez(tmp_path / "request.npz", **message)
    with serving(service, key="sesame") as url:
        port = url.rpartition(":")[2]
        done = subprocess.run(
            [PYTHON, "-c", THEIRS, port, str(tmp_path / "request.npz")],
            capture_output=True, text=True, check=True, timeout=60,
            env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
        )  # fmt: skip
    answer = json.loads(done.stdout)
    assert answer["views"] == ["front"]
    assert "expected float32 [3], got float64 [4]" in answer["words"]
    local = local_chunks(service, [message])[0]
    np.testing.assert_array_equal(np.float32(answer["first"]), local)
    np.testing.assert_array_equal(np.float32(answer["again"]), local)
