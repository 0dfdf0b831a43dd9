import pytest

from benchmarks import plant
from moc_opt.scenario import Setup

TINY = """
tasks = ["circle"]
trials = 1
presets = ["tuned"]
base = { calibration_error_m = 0.0, calibration_tilt_rad = 0.0, encoder_bias_rad = 0.0 }
effects = { none = {}, bias = { encoder_bias_rad = 0.001 } }
calibration = { trials = 1, duration_s = 3.0, sizes = [0.5] }
scenario = { judge = false, bound_samples = 0, duration_s = 0.3 }
"""


def test_registering_again_restores_accuracy(tiny):
    results = tiny(plant, TINY)
    summary = results.summary
    found = summary["effects"]["tuned"]
    assert set(found) == {"none, dcac", "none, exact", "bias, dcac", "bias, exact"}
    none, bias = found["none, exact"], found["bias, exact"]
    own = pytest.approx(none["tip_error_model_mean_mm"], rel=1e-9)
    assert own == none["tip_error_mean_mm"] == none["tip_error_registered_mean_mm"]
    assert bias["tip_error_mean_mm"] > 0.2
    assert bias["tip_error_registered_mean_mm"] < 0.3 * bias["tip_error_mean_mm"]
    assert bias["rcm_error_mean_mm"] > bias["rcm_error_registered_mean_mm"]
    assert ("mu_gain_percent" in none, "mu_gain_percent" in found["none, dcac"]) == (True, False)
    assert [row["part"] for row in results.rows] == ["effects"] * 4 + ["calibration"] * 2 * 4

    by = {(row["kind"], row["size"]): row for row in summary["calibration"]}
    assert set(by) == {(kind, size) for kind in plant.KINDS for size in (0.0, 0.5)}
    none, origins = by["origins", 0.0], by["origins", 0.5]
    assert none["moc_tip_after_mm"] == pytest.approx(none["moc_tip_again_mm"], rel=1e-6)
    assert origins["moc_tip_error_registered_mean_mm"] > 2.0 * origins["dcac_tip_error_registered_mean_mm"]
    assert origins["moc_tip_again_mm"] < 0.5 * origins["moc_tip_after_mm"]
    assert origins["moc_rcm_again_mm"] < 0.7 * origins["moc_rcm_after_mm"]
    assert all("too few trials" in row["undecided"] for row in summary["break_even"])

    # A new registration at tick 0 gives the same errors as the registration before the run.
    case = results.config.cases(plant.CALIBRATION_STREAM, 1)[0]
    setup = Setup(case.change(duration_s=0.6, plant=plant.plant_of(case.plant, "both", 0.5).model_dump()))
    trace = setup.trace()
    start = plant.after_travel(trace, setup, 0)
    assert start["tip_again_mm"] == pytest.approx(start["tip_after_mm"], abs=1e-6)
    assert start["rcm_again_mm"] == pytest.approx(start["rcm_after_mm"], abs=1e-6)
    assert start["tip_again_mm"] < 0.5 < 1e3 * trace.tip_error_m.mean()


@pytest.mark.parametrize(
    ("values", "at"),
    [((0.0, 10.0, 20.0), 0.5), ((6.0, 7.0, 8.0), 0.0), ((0.0, 9.0, 4.0), None), ((9.0, 1.0, 9.0), 1.5)],
)
def test_crossing_is_the_size_above_which_all_values_exceed_the_limit(values, at):
    assert plant.crossing((0.0, 1.0, 2.0), values, 5.0) == at
