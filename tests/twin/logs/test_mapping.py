"""Mappings: units against a table of another library, and errors that name what is wrong."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.twin.logs import formats
from twin.logs.log import Field, LogError
from twin.logs.mapping import UNITS, Source, read_log, read_mapping

# Exact by definition of the units (SI brochure; NIST SP 811, appendix B.8).
DEFINED = {"in": 0.0254, "g": 9.80665, "lbf": 4.4482216152605, "bar": 1e5, "km/h": 1000 / 3600}


@pytest.mark.parametrize(("unit", "factor"), DEFINED.items())
def test_units_are_as_they_are_defined(unit, factor):
    assert UNITS[unit][0] == pytest.approx(factor, rel=1e-15)


def test_a_full_turn_is_the_same_in_every_unit():
    for unit, turn in (("rad", 2.0 * np.pi), ("deg", 360.0), ("rev", 1.0), ("mrad", 2e3 * np.pi)):
        field = Field(np.zeros(1), np.array([turn]))
        signal = Source("sensor", ("turn",), unit).signal({"turn": field})
        assert signal.values[0, 0] == pytest.approx(2.0 * np.pi)
        assert signal.unit == "rad"


def test_commands_within_the_dead_band_do_nothing():
    field = Field(np.arange(4.0), np.array([-0.03, -0.01, 0.019, 0.02]))
    source = Source("actuator", ("duty",), "V", (-1,), scale=12.0, dead_band=0.02)
    np.testing.assert_allclose(source.signal({"duty": field}).values[:, 0], [0.36, 0, 0, -0.24])


def mapping_of(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    return read_mapping(path)


def test_the_example_of_the_docs_is_one(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "running.md").read_text()
    (text,) = re.findall(r"^```toml\n(time = .*?)^```$", page, re.MULTILINE | re.DOTALL)
    mapping = mapping_of(tmp_path, text)
    assert mapping.sources["shoulder"] == Source(
        "actuator", ("/commands.data[1]",), "N m", (1,), pytest.approx(0.004), dead_band=0.02
    )
    assert mapping.sources["tilt"].signs == (-1, 1)
    assert (mapping.time, mapping.time_unit) == ("t", "ms")
    count = mapping.sources["elbow_encoder"].signal(
        {"/counts.elbow": Field(np.zeros(1), np.array([16384.0]))}
    )
    assert count.values[0, 0] == pytest.approx(2.0 * np.pi, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no actuator and no sensor"),
        ("sensor = 1", "unknown entry sensor; there are actuators, episode, sensors"),
        ("[sensors.a]\nunit = 'deg'", "sensors.a: expected either field or fields"),
        ("[sensors.a]\nfield = 'x'\nfields = ['y']", "either field or fields"),
        ("[sensors.a]\nfields = []", "sensors.a: fields are names"),
        ("[sensors.a]\nfield = 3", "sensors.a: fields are names"),
        ("[sensors.a]\nfield = 'x'\nunit = 'degrees'", "unit 'degrees': expected one of"),
        ("[sensors.a]\nfield = 'x'\nunit = ['deg']", "expected one of"),
        ("[sensors.a]\nfield = 'x'\nsign = 2", "sign is 1 or -1"),
        ("[sensors.a]\nfield = 'x'\nscale = 0", "scale is a number above 0"),
        ("[sensors.a]\nfield = 'x'\nsign = [1, 1]", "a list of 1 of these"),
        ("[sensors.a]\nfield = 'x'\ndelay = '4 m'", "delay 'm': expected one of s, ms"),
        ("[sensors.a]\nfield = 'x'\ndelay = 'long'", "delay 'long': expected seconds"),
        ("[sensors.a]\nfield = 'x'\nframe = 1", "frame is a name"),
        ("[sensors.a]\nfield = 'x'\nfactor = 1", "sensors.a: expected some of dead_band, delay"),
        ("[sensors.a]\nfield = 'x'\ndead_band = 1", "dead_band is of an actuator's commands"),
        ("[actuators.a]\nfield = 'x'\ndead_band = -1", "dead_band is a number, at least 0"),
        ("time_unit = 'deg'\n[sensors.a]\nfield = 'x'", "time_unit 'deg': expected one of s"),
        ("episode = 'x'\n[sensors.a]\nfield = 'x'", "episode a whole number"),
        ("[sensors.a]\nfield = 'x'\n[actuators.a]\nfield = 'y'", "a is both an actuator"),
        ("sensors = 1", "sensors: expected a table"),
        ("[sensors", "map.toml"),
    ],
)
def test_a_wrong_mapping_is_one_line_that_names_the_entry(tmp_path, text, said):
    with pytest.raises(LogError) as error:
        mapping_of(tmp_path, text)
    assert said in str(error.value)
    assert str(error.value).startswith(str(tmp_path / "map.toml"))
    assert "\n" not in str(error.value)


def test_a_missing_field_is_named_with_those_that_are_there(tmp_path):
    path = formats.write_csv(formats.Run(1), tmp_path / "run.csv")
    with pytest.raises(LogError, match=r"run.csv: no field elbo; there are elbow, gx, gy"):
        read_log(path, mapping_of(tmp_path, "time = 'clock'\n[sensors.a]\nfield = 'elbo'"))


def test_fields_of_other_times_make_no_vector():
    fields = {"a": Field(np.arange(2.0), np.zeros(2)), "b": Field(np.arange(2.0) + 1, np.zeros(2))}
    with pytest.raises(LogError, match="a, b were not sampled together"):
        Source("sensor", ("a", "b")).signal(fields)


def test_a_foreign_log_needs_a_mapping(tmp_path):
    with pytest.raises(LogError, match="a mapping has to say what its fields are"):
        read_log(formats.write_json_mcap(formats.Run(1), tmp_path / "run.mcap"))
