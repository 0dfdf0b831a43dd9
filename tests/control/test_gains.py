"""Where the gains come from: the settings, or the tables of the robot's file."""

import numpy as np
import pytest

from moc_opt.control import ControlSettings
from moc_opt.errors import ControlError, UnknownNameError

TABLES = {
    "dcac": {"K_X": 2000.0, "D_X": 80.0, "K_N": 600.0, "D_N": 60.0},
    "moc": {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0},
    "default": {"K_X": 2500.0, "D_X": 50.0, "K_N": 700.0, "D_N": 40.0, "K_N2": [1.0, 2.0, 3.0], "D_N2": 2.0},
}
MOC = ControlSettings(gains="moc")


def test_which_table_is_taken():
    assert ControlSettings().resolve_gains(TABLES, 3).K_X == 2500.0
    assert ControlSettings(law="dcac").resolve_gains(TABLES, 3).K_X == 2500.0
    assert ControlSettings(gains=None).resolve_gains(TABLES, 3).K_X == 3000.0
    assert ControlSettings(gains=None, law="dcac").resolve_gains(TABLES, 3).K_X == 2000.0


@pytest.mark.parametrize("settings", [
    ControlSettings(), ControlSettings(gains=None), ControlSettings(gains="moc", K_X=1234.0), ControlSettings.paper(),
    ControlSettings.tuned(), ControlSettings.robust(), ControlSettings(law="dcac", gains=None),
    ControlSettings(third_level="planned"), ControlSettings(third_level="receding", observer_gain_per_s=0.0),
])  # fmt: skip
def test_the_matched_baseline_has_the_same_gains(settings, robot):
    """DCAC with the table, and the settings on top of it, that the given law uses; the observer's gain too."""
    given = settings.resolve_gains(robot.data.gains, 7)
    changed = ControlSettings(**{**settings.model_dump(), **settings.matched_dcac()})
    matched = changed.resolve_gains(robot.data.gains, 7)
    assert changed.law == "dcac"
    assert matched[:4] == given[:4]
    assert not matched.K_N2.any()
    assert changed.observer_rate_per_s == settings.observer_rate_per_s


def test_a_setting_beats_the_table():
    found = MOC.model_copy(update={"K_X": 123.0, "D_N2": 0.0}).resolve_gains(TABLES, 7)
    assert found.K_X == 123.0
    assert not found.D_N2.any()
    assert found.K_N == 800.0


def test_one_number_or_one_per_joint():
    """From the settings and from the robot's table alike."""
    numbers = ControlSettings(gains="moc", K_N2=[3, 2, 1.5]).resolve_gains(TABLES, 3)
    np.testing.assert_array_equal(numbers.K_N2, [3.0, 2.0, 1.5])
    np.testing.assert_array_equal(numbers.D_N2, [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(ControlSettings().resolve_gains(TABLES, 3).K_N2, [1.0, 2.0, 3.0])
    with pytest.raises(ControlError, match=r"K_N2 = .* has 3 entries for 7 joints: give one number, or one per"):
        ControlSettings(gains="moc", K_N2=[3, 2, 1]).resolve_gains(TABLES, 7)
    with pytest.raises(ControlError, match=r"K_N2 = .* in \[gains.default\] of the robot has 3 entries for 2"):
        ControlSettings().resolve_gains(TABLES, 2)
    assert not ControlSettings(dcac_damping=[0.0, 0.0]).damps_dcac
    assert ControlSettings(dcac_damping=[0.0, 1.0]).damps_dcac


def test_unknown_table_lists_the_others():
    with pytest.raises(UnknownNameError, match=r"table of gains 'mocc': did you mean 'moc'.*dcac, default, moc"):
        ControlSettings(gains="mocc").resolve_gains(TABLES, 7)


def test_a_missing_gain_is_named():
    with pytest.raises(ControlError, match=r"K_N2: not set, and \[gains.dcac\] of the robot has none"):
        ControlSettings(law="moc", gains="dcac").resolve_gains(TABLES, 7)
    found = ControlSettings(law="moc", gains="dcac", K_N2=10.0, D_N2=1.0).resolve_gains(TABLES, 7)
    np.testing.assert_array_equal(found.K_N2, np.full(7, 10.0))
    assert not ControlSettings(law="dcac", gains="dcac").resolve_gains(TABLES, 7).K_N2.any()  # not needed


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), (1.0, 2.0), "stiff"])
@pytest.mark.parametrize("gain", ["D_X", "K_N2"])
def test_a_bad_number_in_the_robot_s_table(gain, value):
    with pytest.raises(
        ControlError, match=rf"{gain} = .* in \[gains.moc\] of the robot(: give| has 2 entries .*: give) one number"
    ):
        MOC.resolve_gains({"moc": {**TABLES["moc"], gain: value}}, 7)
