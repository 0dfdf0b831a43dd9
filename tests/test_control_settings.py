"""What a controller can be told, and where its gains come from."""

import pytest

from moc_opt.control import ControlSettings
from moc_opt.control.settings import GAINS
from moc_opt.errors import ControlError, UnknownNameError

TABLES = {
    "dcac": {"K_X": 2000.0, "D_X": 80.0, "K_N": 600.0, "D_N": 60.0},
    "moc": {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0},
}


def test_table_one_of_the_paper(robot):
    """Gains the paper prints for DCAC and MOC."""
    dcac = ControlSettings(law="dcac").resolve_gains(robot.data.gains)
    moc = ControlSettings(law="moc").resolve_gains(robot.data.gains)
    assert (dcac["K_X"], dcac["K_N"]) == (2000.0, 600.0)
    assert (moc["K_X"], moc["K_N"], moc["K_N2"], moc["D_N2"]) == (3000.0, 800.0, 80.0, 1.0)


def test_matched_gains(robot):
    dcac = ControlSettings(law="dcac", gains="moc").resolve_gains(robot.data.gains)
    moc = ControlSettings(law="moc").resolve_gains(robot.data.gains)
    assert {gain: dcac[gain] for gain in GAINS[:4]} == {gain: moc[gain] for gain in GAINS[:4]}


def test_a_setting_beats_the_table():
    found = ControlSettings(K_X=123.0, D_N2=0.0).resolve_gains(TABLES)
    assert found["K_X"] == 123.0
    assert found["D_N2"] == 0.0
    assert found["K_N"] == 800.0


def test_unknown_table_lists_the_others():
    with pytest.raises(UnknownNameError, match=r"table of gains 'mocc': did you mean 'moc'.*dcac, moc"):
        ControlSettings(gains="mocc").resolve_gains(TABLES)


def test_a_missing_gain_is_named():
    with pytest.raises(ControlError, match=r"K_N2: not set, and \[gains.dcac\] of the robot has none"):
        ControlSettings(law="moc", gains="dcac").resolve_gains(TABLES)
    found = ControlSettings(law="moc", gains="dcac", K_N2=10.0, D_N2=1.0).resolve_gains(TABLES)
    assert found["K_N2"] == 10.0
    assert ControlSettings(law="dcac").resolve_gains(TABLES)["K_N2"] == 0.0  # not needed


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), (1.0, 2.0), "stiff"])
def test_a_bad_number_in_the_robot_s_table(value):
    with pytest.raises(
        ControlError, match=r"D_X = .* in \[gains.moc\] of the robot: give one number of 0 or more"
    ):
        ControlSettings().resolve_gains({"moc": {**TABLES["moc"], "D_X": value}})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("K_X", 0.0), ("K_X", -1.0), ("D_X", -1.0), ("K_N", 0.0), ("K_N2", -1.0), ("D_N2", -0.1), ("k0_per_s", 0.0),
        ("c0", -0.01), ("c1", float("nan")), ("c2", -1e-3), ("damping", -1e-9), ("observer_gain_per_s", -1.0),
        ("dcac_damping", -1.0), ("law", "both"), ("projector", "kinetic"), ("fallback", "stop"),
        ("limit_torque", "perhaps"), ("feedforward", 3),
        ("speed_fraction", 0.0), ("speed_fraction", 1.5), ("ramp_s", -0.1), ("limit_margin_rad", -0.1),
    ],
)  # fmt: skip
def test_wrong_values(field, value):
    with pytest.raises(ControlError, match=rf"\[control\] {field} = .*: input should be"):
        ControlSettings(**{field: value})


def test_unknown_field():
    with pytest.raises(UnknownNameError, match=r"\[control\] 'k0': did you mean .*c0"):
        ControlSettings(k0=2.0)


def test_paper_preset():
    paper = ControlSettings.paper()
    assert (paper.c0, paper.c1, paper.c2, paper.k0_per_s) == (0.01, 0.01, 0.001, 0.1)
    assert (paper.damping, paper.observer_gain_per_s, paper.feedforward) == (0.0, 0.0, False)
    assert (paper.speed_fraction, paper.limit_margin_rad, paper.ramp_s) == (1.0, 0.0, 0.0)
    assert ControlSettings.paper(k0_per_s=1.0).k0_per_s == 1.0


def test_presets_by_name():
    assert ControlSettings.preset("paper", law="dcac") == ControlSettings.paper(law="dcac")
    assert ControlSettings.preset("tuned") == ControlSettings.tuned()
    assert ControlSettings.tuned(K_N=900.0).K_N == 900.0
    assert ControlSettings.tuned().law == "moc"
    with pytest.raises(UnknownNameError, match=r"control preset 'papr': did you mean 'paper'"):
        ControlSettings.preset("papr")


def test_default_weights():
    """rho/c2 between 1e-3 and 1e-1 is useful."""
    default = ControlSettings()
    assert 1e-3 <= default.damping / default.c2 <= 1e-1
