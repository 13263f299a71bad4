"""Open3D without what it brings to draw in browsers, which is there all the same when somebody asks for it."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys
import numpy as np
from brafit.cloud.open3d_runtime import open3d

module = open3d()
assert not {"dash", "plotly"} & set(sys.modules), "loaded"
cloud = module.geometry.PointCloud(module.utility.Vector3dVector(np.eye(3)))
for _ in range(2):
    figure = module.visualization.get_plotly_fig([cloud])
    assert len(figure.data[0].x) == 3
    assert callable(module.visualization.draw_plotly)
assert "plotly" in sys.modules
"""


def test_drawing_in_browsers_is_loaded_when_it_is_called() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
