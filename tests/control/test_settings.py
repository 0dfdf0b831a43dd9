"""What a controller can be told."""

import json

import numpy as np
import pytest

from moc_opt.control import ControlSettings
from moc_opt.control.law import law_of, law_views
from moc_opt.errors import ControlError, UnknownNameError


def test_per_joint_settings_survive_a_file():
    """A list comes back from JSON as the same setting."""
    given = ControlSettings(K_N2=[1.0, 2.0], dcac_damping=(3.0, 4.0))
    assert ControlSettings(**json.loads(given.model_dump_json())) == given


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("K_X", 0.0), ("K_X", -1.0), ("D_X", -1.0), ("K_N", 0.0), ("K_N2", -1.0), ("D_N2", -0.1), ("k0_per_s", 0.0),
        ("c0", -0.01), ("c1", float("nan")), ("c2", -1e-3), ("regularization", -1e-9), ("observer_gain_per_s", -1.0),
        ("dcac_damping", -1.0), ("K_N2", [1.0, -1.0]), ("D_N2", "soft"), ("dcac_damping", [float("nan")]),
        ("law", "both"), ("projector", "kinetic"), ("fallback", "stop"),
        ("limit_torque", "perhaps"), ("feedforward", 3),
        ("rcm_lambda", 0.0), ("rcm_lambda", 1.1),
        ("speed_fraction", 0.0), ("speed_fraction", 1.5), ("ramp_s", -0.1), ("limit_margin_rad", -0.1),
        ("limit_margin_m", -0.1),
    ],
)  # fmt: skip
def test_wrong_values(field, value):
    with pytest.raises(ControlError, match=rf"\[control\] {field} = .*: input should be"):
        ControlSettings(**{field: value})


def test_the_former_name_of_the_regularization():
    """`damping` is taken wherever `regularization` is, with presets and changes too; never both at once."""
    old = ControlSettings(damping=3e-4)
    assert old == ControlSettings(regularization=3e-4)
    assert old.damping == 3e-4
    assert ControlSettings.preset("tuned", damping=3e-4) == ControlSettings.preset("tuned", regularization=3e-4)
    assert old.replace({"damping": 1e-6}).regularization == 1e-6
    with pytest.raises(ControlError, match=r"\[control\] regularization = 1e-05 is given beside damping = 0.001, its"):
        ControlSettings(regularization=1e-5, damping=1e-3)
    with pytest.raises(ControlError, match=r"\[control\] regularization = -1.0: input should be"):
        ControlSettings(damping=-1.0)


def test_unknown_field():
    with pytest.raises(UnknownNameError, match=r"\[control\] key 'k0': did you mean .*c0"):
        ControlSettings(k0=2.0)


def test_paper_preset():
    paper = ControlSettings.paper()
    assert (paper.c0, paper.c1, paper.c2, paper.k0_per_s) == (0.01, 0.01, 0.001, 0.1)
    assert (paper.regularization, paper.observer_gain_per_s, paper.feedforward) == (0.0, 0.0, False)
    assert (paper.speed_fraction, paper.limit_margin_rad, paper.limit_margin_m, paper.ramp_s) == (1.0, 0.0, 0.0, 0.0)
    assert ControlSettings.paper(k0_per_s=1.0).k0_per_s == 1.0


def test_presets_by_name():
    assert ControlSettings.preset("paper", law="dcac") == ControlSettings.paper(law="dcac")
    assert ControlSettings.preset("tuned") == ControlSettings.tuned()
    softer = ControlSettings.tuned(gains="robust", observer_gain_per_s=22.0, course_observer_gain_per_s=22.0)
    assert ControlSettings.preset("robust") == softer
    assert ControlSettings.tuned(K_N=900.0).K_N == 900.0
    assert ControlSettings.tuned().law == "moc"
    with pytest.raises(UnknownNameError, match=r"control preset 'papr': did you mean 'paper'"):
        ControlSettings.preset("papr")


def test_default_weights():
    """rho/c2 between 1e-3 and 1e-1 is useful."""
    default = ControlSettings()
    assert 1e-3 <= default.regularization / default.c2 <= 1e-1


def test_gains_given_as_a_table_are_sent_to_where_they_belong():
    with pytest.raises(ControlError, match=r"gains = .*single gains are keys of \[control\] itself"):
        ControlSettings(gains={"K_N2": 80.0})


def test_the_old_name_of_the_published_projector_is_understood():
    assert ControlSettings(projector="printed") == ControlSettings(projector="as_published")
    with pytest.raises(ControlError, match="projector = 'prints'"):
        ControlSettings(projector="prints")


def test_under_a_course_the_box_leaves_the_course_its_speed_and_what_differs_from_it_is_damped(robot):
    rows = {}
    for level in ("local", "planned"):
        settings = ControlSettings(third_level=level)
        law = law_views.py_func(law_of(settings, robot), robot.n)
        assert settings.limit_margins(robot.chain.prismatic)[0] == {"local": 0.15, "planned": 0.05}[level]
        rows[level] = law
    local, planned = rows["local"], rows["planned"]
    np.testing.assert_allclose(planned.limits[2], robot.v_max)
    np.testing.assert_allclose(local.limits[2], 0.5 * robot.v_max)
    # At x = v no torque: a speed that is wanted is not damped, a speed that is not wanted as much as ever.
    np.testing.assert_array_equal(planned.D_N2, 0.0)
    np.testing.assert_allclose(planned.K_N2, local.K_N2 + local.D_N2)
    assert local.D_N2.max() > 0.0
    assert (local.k0, planned.k0) == (2.0, 10.0)


def test_the_observer_under_a_course_has_its_own_gain_and_stays_off_where_it_is_off():
    assert ControlSettings().observer_rate_per_s == 20.0
    assert ControlSettings(third_level="receding").observer_rate_per_s == 40.0
    assert ControlSettings(third_level="receding", observer_gain_per_s=0.0).observer_rate_per_s == 0.0


@pytest.mark.parametrize("name", ["tuned", "robust"])
def test_a_preset_has_no_faster_observer_under_a_course(name):
    """It was found, or softened, together with the gains: the delay that the loop bears depends on it."""
    settings = ControlSettings.preset(name, third_level="planned")
    assert settings.observer_rate_per_s <= ControlSettings.preset(name).observer_gain_per_s
