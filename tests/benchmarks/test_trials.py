"""The trials of every study are independent: no two of them share a seed, a start or an error of registration."""

from pathlib import Path

import pytest

from benchmarks import faults, paper, plan, plant, robots, sweep
from benchmarks.common.output import default_config
from benchmarks.maintenance import coverage, tune
from benchmarks.sweeps.config import chosen_seeds
from moc_opt.scenario import Setup
from moc_opt.study import solvers
from moc_opt.study.command import CONFIGS

SET_UP = 15
"""Trials of a study whose starts and errors are looked at, spread over all of them: a start takes a while to find."""


def shipped(command, name):
    return command.Config.load(default_config(name))


def of_solvers(name):
    folder = Path(solvers.__file__).parent if name == "solvers" else CONFIGS
    return solvers.Config.load(folder / f"{name}.toml").cases()


def of_plan(name):
    return [job.trial for job in shipped(plan, name).jobs() if job.part == "courses"]


def of_robots(arm):
    return [case for case in shipped(robots, "robots").cases() if case.robot.name == arm]


def of_plant():
    jobs = shipped(plant, "plant").jobs()
    return [job.trial for job in jobs if job.about == jobs[0].about]


def of_paper():
    jobs = shipped(paper, "paper").jobs()
    return [job.trial for job in jobs if job.group == jobs[0].group]


def of_faults():
    jobs = shipped(faults, "faults").jobs()
    return [job.scenario for job in jobs if job.controller == jobs[-1].controller]


def of_sweep(name):
    config = shipped(sweep, name)
    return [config.scenario.change(seed=seed) for seed in chosen_seeds(config)]


def of_tune():
    config = shipped(tune, "tune")
    found = []
    for stream, per_task in ((tune.SEARCH_STREAM, config.trials), (tune.FINAL_STREAM, config.final_trials)):
        own = tune.seeds(config.seed, stream, per_task * len(config.tasks))
        found += [trial for _, trial in tune.trials(config.scenario, config.tasks, own)]
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
    pool = solvers.Config(seed=coverage.SEED, closed_loop={"trials": 1000}).cases()
    study = {trial.seed for name in ("solvers", "solvers-long") for trial in of_solvers(name)}
    assert not study & {trial.seed for trial in pool}
