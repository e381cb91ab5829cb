"""The table of instruments: what the tool files say, and what is asked for by a wrong name."""

import math

import pytest

from hardware.codes import InputError
from hardware.dvrk.instruments import ARM_LOWER, ARM_UPPER, instrument

# name, a6, roll, wrist pitch, wrist yaw, jaw from and to: the figures of the tool files [m, rad]
TOOLS = [
    ("LARGE_NEEDLE_DRIVER:400006", 0.0091, 4.53786, 1.39626, 1.39626, -0.698132, 1.39626),
    ("FENESTRATED_BIPOLAR_FORCEPS:400205", 0.0107, 4.4506, 1.2217, 1.5708, -0.698132, 1.39626),
    ("PROGRASP_FORCEPS:400093", 0.0107, 4.53786, 1.39626, 1.39626, -0.349066, 1.39626),
    ("CADIERE_FORCEPS:400049", 0.0091, 4.53786, 1.39626, 1.39626, -0.349066, 1.39626),
    ("DEBAKEY_FORCEPS:400036", 0.0091, 4.53786, 1.39626, 1.39626, -0.349066, 1.39626),
    ("MARYLAND_BIPOLAR_FORCEPS:400172", 0.0107, 4.4506, 1.2217, 1.5708, -0.349066, 1.39626),
    ("POTTS_SCISSORS:400001", 0.0091, 4.53786, 1.39626, 1.39626, -0.698132, 0.5236),
    ("ROUND_TIP_SCISSORS:400007", 0.0091, 4.53786, 1.39626, 1.39626, -0.698132, 0.698132),
    ("CURVED_SCISSORS:400178", 0.0091, 4.53786, 1.39626, 1.39626, -0.349066, 1.39626),
    ("MONOPOLAR_CURVED_SCISSORS:400179", 0.0091, 4.53786, 1.39626, 1.39626, -0.349066, 1.39626),
    ("PERMANENT_CAUTERY_SPATULA:400184", 0.0093, 4.53786, 1.39626, 1.4835, 0.0, 0.5),
    ("PERMANENT_CAUTERY_HOOK:400183", 0.0093, 4.53786, 1.39626, 1.4835, 0.0, 0.5),
]


@pytest.mark.parametrize(("name", "a6", "roll", "pitch", "yaw", "jaw_lower", "jaw_upper"), TOOLS)
def test_an_instrument_has_the_figures_of_its_tool_file(
    name: str, a6: float, roll: float, pitch: float, yaw: float, jaw_lower: float, jaw_upper: float
) -> None:
    tool = instrument(name)

    assert tool.name == name
    assert tool.a6 == a6
    assert tool.upper[3:] == pytest.approx((roll, pitch, yaw), abs=5e-5)
    assert tool.lower[3:] == pytest.approx((-roll, -pitch, -yaw), abs=5e-5)
    assert (tool.jaw_lower, tool.jaw_upper) == pytest.approx((jaw_lower, jaw_upper), abs=5e-5)


def test_every_instrument_has_the_arms_own_limits() -> None:
    lower, upper = instrument("POTTS_SCISSORS:400001").limits()

    assert tuple(lower[:3]) == ARM_LOWER == (-1.588, -0.925025, 0.0)
    assert tuple(upper[:3]) == ARM_UPPER == (1.588, 0.925025, 0.24)


def test_potts_scissors_open_to_thirty_degrees_and_no_further() -> None:
    assert instrument("POTTS_SCISSORS:400001").jaw_upper == pytest.approx(math.radians(30.0))


@pytest.mark.parametrize("name", ["PERMANENT_CAUTERY_SPATULA:400184", "PERMANENT_CAUTERY_HOOK:400183"])
def test_cautery_has_no_jaw(name: str) -> None:
    assert not instrument(name).has_jaw


def test_everything_else_has_a_jaw() -> None:
    assert all(instrument(name).has_jaw for name, *_ in TOOLS if "CAUTERY" not in name)


def test_an_unknown_instrument_is_an_error_that_names_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'VESSEL_SEALER:400299' is not known.*POTTS_SCISSORS:400001"):
        instrument("VESSEL_SEALER:400299")


def test_a_misspelt_instrument_is_told_its_near_one() -> None:
    with pytest.raises(InputError, match=r"did you mean POTTS_SCISSORS:400001\?"):
        instrument("potts_scissors:40001")


def test_no_instrument_is_an_error() -> None:
    with pytest.raises(InputError, match="'' is not known"):
        instrument("")
