"""Hidden robots: simulated by plain MuJoCo steps, and logged as CSV files."""

import csv

import mujoco
import numpy as np

from experiments.own import identification

ROBOTS = identification.__file__.rpartition("/")[0] + "/robots"
PERIOD, SAMPLING = 0.002, 0.01
"""Between two commands, and two samples [s]."""
LATE = 0.0033
"""Of the samples, after the commands [s]."""
FINE = 20
"""Steps of the hidden robot in one of the model."""
SWINGS = {
    "arm": ([0.0, 0.3, 0.6, 0.0, 0.5, 0.0], [1.0, 0.6, 0.8, 1.0, 0.8, 1.0]),
    "leg": ([0.0, 0.5, -1.0], [0.3, 0.4, 0.4]),
    "cart": ([0.0], [10.0]),
}
"""Middle and amplitude of each actuator's command."""


def robot(name):
    return f"{ROBOTS}/{name}.xml"


def commands(name, duration, generator):
    """Sums of three sines, which begin at rest."""
    stamps = np.arange(0.0, duration, PERIOD)
    middle, size = (np.array(each) for each in SWINGS[name])
    waves = np.zeros((len(stamps), len(middle)))
    for _ in range(3):
        rates = 2.0 * np.pi * generator.uniform(0.1, 2.0, len(middle))
        waves += np.sin(np.outer(stamps, rates) + generator.uniform(0.0, 6.0, len(middle)))
    return stamps, middle + size / 3.0 * waves * np.minimum(stamps, 1.0)[:, None]


def measured(name, change, stamps, values, generator, delay=0.0):
    """Return sample times, and samples by sensor, of a robot that is changed and settled first."""
    spec = mujoco.MjSpec.from_file(robot(name))
    spec.option.timestep /= FINE
    change(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    step = model.opt.timestep
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = values[0]
    mujoco.mj_step(model, data, round(2.0 / step))
    data.time = 0.0
    times = np.arange(LATE, stamps[-1], SAMPLING)
    rows = np.empty((len(times), model.nsensordata))
    done = 0
    for tick in range(round((stamps[-1]) / step) + 1):
        now = tick * step
        late = max(0, int(np.floor((now - delay) / PERIOD + 1e-9)))
        data.ctrl[:] = values[late]
        mujoco.mj_step(model, data)  # sensors are those of the beginning of the step
        while done < len(times) and times[done] <= now + 0.5 * step:
            rows[done] = data.sensordata
            done += 1
    noise = np.repeat(model.sensor_noise, model.sensor_dim)
    return times, rows[:done] + noise * generator.standard_normal(rows[:done].shape)


def write_csv(path, name, stamps, values, times, rows):
    """One table: commands where they come, samples where they are taken, nothing elsewhere."""
    model = mujoco.MjSpec.from_file(robot(name)).compile()
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["t"]
            + [f"u{index}" for index in range(model.nu)]
            + [f"y{index}" for index in range(model.nsensordata)]
        )
        lines = [[t, *u, *[""] * model.nsensordata] for t, u in zip(stamps, values, strict=True)]
        lines += [[t, *[""] * model.nu, *y] for t, y in zip(times, rows, strict=True)]
        writer.writerows(sorted(lines, key=lambda line: line[0]))


def write_mapping(path, name):
    model = mujoco.MjSpec.from_file(robot(name)).compile()
    lines = []
    for index in range(model.nu):
        lines += [f"[actuators.{model.actuator(index).name}]", f'field = "u{index}"']
    for index in range(model.nsensor):
        first = model.sensor_adr[index]
        fields = [f"y{first + each}" for each in range(model.sensor_dim[index])]
        lines += [f"[sensors.{model.sensor(index).name}]", f"fields = {fields}"]
    path.write_text("\n".join(lines) + "\n")
