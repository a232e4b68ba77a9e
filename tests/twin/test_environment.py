import subprocess
import sys

import numpy as np
import pytest

from models.compose import RobotPlacement

dm_env = pytest.importorskip("dm_env", reason="dm_control has no wheels for Python 3.13")
from dm_control.suite.wrappers import action_scale, pixels  # noqa: E402

from twin.environment import make_environment  # noqa: E402


@pytest.fixture(scope="module")
def environment():
    made = make_environment(time_limit=0.5)
    yield made
    made.close()


def test_episode_is_a_dm_env_episode_of_the_given_length(environment):
    assert isinstance(environment, dm_env.Environment)
    step = environment.reset()
    assert step.first()
    spec = environment.action_spec()
    assert spec.shape == (8,) and np.all(spec.minimum == -1) and np.all(spec.maximum == 1)
    count = 0
    while not step.last():
        step = environment.step(np.full(8, 0.2))
        count += 1
    assert count == 50
    assert environment.physics.time() == pytest.approx(0.5)
    assert step.observation["rover1/wheel_speeds"].mean() > 0.1


def test_episodes_are_alike_bit_for_bit(environment):
    runs = []
    for _ in range(2):
        environment.reset()
        steps = [environment.step(np.full(8, 0.3)) for _ in range(20)]
        runs.append(np.concatenate([np.concatenate(list(s.observation.values())) for s in steps]))
    assert runs[0].tobytes() == runs[1].tobytes()


def test_two_robots_have_sixteen_actions():
    environment = make_environment(
        (RobotPlacement("rover1", (-0.5, 0.0)), RobotPlacement("rover2", (0.5, 0.0)))
    )
    assert environment.action_spec().shape == (16,)
    step = environment.reset()
    assert "rover2/gyro" in step.observation


def test_wrappers_for_pixels_and_action_scale_work(environment):
    scaled = action_scale.Wrapper(environment, minimum=-12.0, maximum=12.0)
    wrapped = pixels.Wrapper(scaled, render_kwargs={"height": 48, "width": 64, "camera_id": 0})
    wrapped.reset()
    step = wrapped.step(np.full(8, 6.0))
    image = step.observation["pixels"]
    assert image.shape == (48, 64, 3) and image.std() > 5
    np.testing.assert_allclose(environment.physics.data.ctrl, 6.0)


def test_without_dm_control_it_says_what_to_install():
    hidden = "import sys; sys.modules['dm_control'] = None; import twin.environment"
    done = subprocess.run(
        [sys.executable, "-c", hidden], capture_output=True, text=True, check=False
    )
    assert "needs dm_control: pip install 'fieldtwin[dm_control]'" in done.stderr.splitlines()[-1]
