"""One test frame, rendered in a process of its own: a broken driver may kill it."""

import hashlib
import json
import os
import sys

SCENE = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="1 1 0.1"/>
    <geom type="box" size="0.1 0.1 0.1" pos="0 0 0.1" rgba="0.8 0.3 0.1 1"/>
  </worldbody>
</mujoco>
"""


def probe() -> dict[str, str]:
    """Render a box on a plane.

    Returns:
        ``renderer`` and ``version`` as the GL driver names them, and the frame's ``checksum``.

    Raises:
        RuntimeError: If the frame is empty; other exceptions come from the driver.
    """
    import mujoco  # noqa: PLC0415  (MUJOCO_GL must be set first)

    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, 48, 64) as renderer:
        renderer.update_scene(data)
        frame = renderer.render()
        from OpenGL import GL  # noqa: PLC0415  (only valid while a context lives)

        names = {
            "renderer": GL.glGetString(GL.GL_RENDERER),
            "version": GL.glGetString(GL.GL_VERSION),
        }
    if frame.std() == 0:
        raise RuntimeError("the frame has one colour only")
    found = {key: name.decode() if name else "unknown" for key, name in names.items()}
    return {**found, "checksum": hashlib.sha256(frame.tobytes()).hexdigest()[:16]}


if __name__ == "__main__":
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")
    print(json.dumps(probe()))
