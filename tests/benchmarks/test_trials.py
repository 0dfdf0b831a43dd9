"""The trials of every study are independent: no two of them share a seed, a start or an error of registration."""

import pytest

from benchmarks import coverage, faults, paper, plan, plant, robots, solvers, sweep, tune
from benchmarks.common.output import default_config
from benchmarks.solver_study.cases import drawn
from moc_opt.scenario import Setup

SET_UP = 15
"""Trials of a study whose starts and errors are looked at, spread over all of them: a start takes a while to find."""


def shipped(command, name):
    return command.Config.load(default_config(name))


def of_solvers(name):
    config = shipped(solvers, name)
    return list(drawn(config.scenario, config.closed_loop.tasks, config.seed, config.closed_loop.trials).values())


def of_plan(name):
    return shipped(plan, name).cases()


def of_robots(arm):
    return [case for case in shipped(robots, "robots").cases() if case.robot.name == arm]


def of_plant():
    config = shipped(plant, "plant")
    return [*config.cases(), *config.cases(plant.CALIBRATION_STREAM, config.calibration.trials)]


def of_paper():
    return shipped(paper, "paper").cases("paper")


def of_faults():
    return shipped(faults, "faults").scenarios()


def of_sweep(name):
    config = shipped(sweep, name)
    return [config.scenario.change(seed=seed) for seed in config.chosen_seeds()]


def of_tune():
    config = shipped(tune, "tune")
    found = []
    for stream, per_task in ((tune.SEARCH_STREAM, config.trials), (tune.FINAL_STREAM, config.final_trials)):
        own = tune.seeds(config.seed, stream, per_task * len(config.tasks))
        found += tune.trials(config.scenario, config.tasks, own, virtual=True)
    return found


@pytest.mark.parametrize(
    ("study", "given"),
    [
        (of_solvers, ["solvers"]), (of_solvers, ["solvers-long"]), (of_plan, ["plan"]), (of_plan, ["plan-limits"]),
        (of_robots, ["lwr4"]), (of_robots, ["gen3"]), (of_plant, []), (of_paper, []), (of_faults, []),
        (of_sweep, ["sweep"]), (of_sweep, ["margins"]), (of_tune, []),
    ],
)  # fmt: skip
def test_no_two_trials_share_a_seed_a_start_or_a_registration(study, given):
    found = study(*given)
    assert len({trial.seed for trial in found}) == len(found) > 1
    some = [Setup(trial.change(best_courses=False)) for trial in found[:: -(-len(found) // SET_UP)]]
    starts = {(setup.robot.data.name, *setup.q_start.round(9)) for setup in some}
    assert len(starts) == len(some)
    errors = {tuple(setup.plant.mismatch.registration_error) for setup in some}
    assert len(errors) == len(some)


def test_the_pool_behind_the_coverage_shares_no_trial_with_the_study():
    pool = {case.seed for case in coverage.Config().cases()}
    assert len(pool) == coverage.Config().trials
    assert not {trial.seed for name in ("solvers", "solvers-long") for trial in of_solvers(name)} & pool
