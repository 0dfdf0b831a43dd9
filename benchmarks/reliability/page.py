"""docs/reliability.md: what is promised, how each promise is tested, and the figures that a run of this benchmark gave.

The page is a function of docs/reliability.json alone. `python -m benchmarks.faults --page` and
`python -m benchmarks.fuzz --page` write both, each its own figures.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks import output
from benchmarks.reliability.report import CASES, GOALS, SEEN, by_group, headline, markdown
from moc_opt.errors import ScenarioError
from moc_opt.report.tables import Column

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"

COUNTS = [
    Column("kind", "input"),
    *(Column(name, name, format=".0f") for name in ("cases", "accepted", "refused", "failed")),
]
PROMISES = (
    (
        "Tip and RCM control never depend on the third level.",
        "The torque of a tick whose answer is refused equals, in the tip and RCM directions, that of the same tick "
        "with a good answer: `J M^-1 tau` is the same to rounding.",
        "`tests/control/test_supervisor.py`",
    ),
    (
        "An answer that raised, is missing, has not the form of a Solution (an x or duals of another kind, a count "
        "that no trace can hold), is not finite, leaves the box, misses the references, is claimed to be optimal and"
        " is not, or comes too late is refused, counted, and named in the trace column `fault`. The last good answer"
        " is held for `hold_ticks` ticks, then the self-motion is damped; where damping would lead a joint out of "
        "the box, the elbow moves just as far as the box asks for (`keep_off_limits`).",
        "Every kind is injected at a seeded share of the ticks, and every tick of the trace is compared with the draw; "
        "a start from which damping alone ends at a joint limit; the fallback against a bounded least-squares solver.",
        "`tests/control/test_supervisor.py`, `tests/solvers/test_faulty.py`, `tests/control/test_null_space.py`, "
        "this benchmark",
    ),
    (
        "No solver grades itself: it sees a copy of the subproblem and of the measured velocity, and its answer is "
        "copied before it is looked at. What it writes into either reaches neither the check, nor the torque, nor "
        "the trace. Whatever it throws at a tick (SystemExit too, in `observe` as in `solve`) is a counted fault; a "
        "solver that throws when it is asked or started, or starts nothing, is refused in its own words. A user's "
        "Ctrl-C ends the run. `run` says in the second row at how many ticks the solver was replaced.",
        "A solver that makes the subproblem writable, widens the box, zeroes A and answers 50 rad/s; Hypothesis over "
        "answers under every status; exceptions of every kind.",
        "`tests/control/test_supervisor.py`, `tests/benchmarks/solver_study/test_answers.py`, "
        "`tests/report/test_run_table.py`, "
        "this benchmark",
    ),
    (
        "An honest answer is taken, also a loose one.",
        "Every registered solver runs in a short closed loop at its default settings.",
        "`tests/control/test_supervisor.py`",
    ),
    (
        "Torque and torque rate stay within their limits at every tick; a joint that is too fast, or too close to its "
        "limit for its speed, is braked.",
        "Hypothesis over states and torques; a saboteur that asks for twice the largest torques in random directions "
        "does not get a joint of the plant past its position limit.",
        "`tests/control/test_safety_filter_runs.py`",
    ),
    (
        "A measurement that cannot be true is bridged for `patience_ticks` ticks; then the drives brake, the torque "
        "carries the arm's weight in the last plausible pose, and the run ends with the trace so far and "
        "`meta[\"ended\"] = \"stopped: ...\"`. The same happens when the controller breaks down, when its torque is no "
        "number, and when the tip has been far from its reference for a while: an unstable loop does not go on.",
        "NaN, jumps, a controller that raises, and five ticks of delay, in the plant.",
        "`tests/control/test_safety_filter_runs.py`, this benchmark",
    ),
    (
        "A measurement has an age, and it must show the motion that the torque made. Packets that stop, are lost, "
        "are repeated or lag are bridged for `patience_ticks` ticks beyond the delay with which the first one came, "
        "and then the arm is stopped, on every task, however small. So are readings that are up to date by their "
        "number alone: positions that do not follow their velocities, all encoders repeating one reading to the last"
        " bit while the tip is told to move or the torque changes, one encoder repeating while its joint must have "
        "gathered 0.2 rad/s, readings with noise that came before, and a momentum residual that leaves its mean by a "
        "fifth of the largest torque.",
        "Hypothesis over orders of packets; packets dropped, frozen, late, replayed and forged in the plant, at "
        "poses and moments that no level was chosen on; constant delays of 0 to 3 ticks and gaps of 3, which stop "
        "nothing.",
        "`tests/control/test_motion.py`, `tests/control/test_motion_runs.py`, `tests/sim/test_packets.py`, "
        "this benchmark",
    ),
    (
        "A stop holds the arm where it is: within 25 mm from any swivel with drives of 8 to 100 % of their torque, "
        "within 3 mm under 0.7 kg or masses that are 30 % wrong. While the trocar presses with more than "
        "`stop_yield_N` the brakes open, and the tissue pushes the arm back until the force has halved.",
        "Starts at both ends of the swivel, weak drives, unknown loads, and trocars that slip by 30 and 100 mm.",
        "`tests/scenario/test_stop_runs.py`",
    ),
    (
        "The shaft stays near the registered trocar, and the trocar is not pressed hard: each as a root mean square "
        "over 0.1 s has a level at which the run warns (6 mm, 8 N; `meta[\"warnings\"]`) and a limit at which it "
        "stops in the same way (12 mm, 15 N). Both are settings of `[guard]`, off only by choice (`inf`).",
        "An arm that its wall keeps 14 mm off goes on without the limit and is stopped with it; a trocar that slips "
        "by 100 mm; under DCAC and MOC, in Python and in C, on the live page and in the procedure; the force against "
        "statics and the plant.",
        "`tests/control/test_incision_runs.py`",
    ),
    (
        "A run that oscillates says so: `meta[\"ended\"] = \"oscillated: joint_7 at 47 Hz, 0.51 rad/s\"`. What did "
        "not end \"completed\" is not a success: it leaves `python -m moc_opt run` with status 3, its ending stands "
        "first, figures of a part are marked, and stopped runs enter no mean of a benchmark.",
        "Two ticks of delay and an idle joint without friction, under one gain of 80 for all joints; sound runs of "
        "every preset; synthetic motions of known size and frequency, on both sides of each limit.",
        "`tests/trace/test_oscillation.py`, `tests/control/test_safety_filter_runs.py`",
    ),
    (
        "Bad input ends in success or in a MocOptError whose message names the field: never a traceback from inside, a "
        "hang or a wrong answer.",
        "Hypothesis over scenario files, robot files (TOML and URDF), subproblems and result files (Parquet and JSON): "
        "`python -m benchmarks.fuzz --cases 10000`.",
        "`tests/benchmarks/test_fuzz.py`",
    ),
    (
        "Files from strangers run no code, and nothing in them decides where files go. Names of robots, links, joints, "
        "scenarios and solvers come from an allow-list of characters, checked where they are read "
        "(`moc_opt/inputs/names.py`); a comment of generated C, a page and a file's name hold any text without harm "
        "even so. "
        "Options of a solver's library come from an allow-list for each library (`moc_opt/solvers/options.py`): "
        "tolerances, iterations and modes; what writes, reads, loads or compiles is refused by name, and IPOPT reads "
        "no `ipopt.opt`.",
        "Hypothesis over names, against a C compiler's rules of comments and the tags of a page; over options, with "
        "the folder watched; every allowed option is set once, every option that writes is refused.",
        "`tests/inputs/test_names.py`, `tests/solvers/test_options.py`",
    ),
    (
        "The controller's model and the plant are one arm. Every number of a URDF is read once, strictly (decimal, "
        "finite, of a size that an arm can have), and written anew for both engines; an inertia that no body has is "
        "refused; before a run inertia, bias forces, tip and wrist of pinocchio and MuJoCo are compared at three "
        "poses, to 1e-6.",
        "Hypothesis over the numbers of a URDF; texts that one engine drops and the other keeps; heaps of masses, none "
        "of whose inertias may be refused.",
        "`tests/robots/test_numbers.py`, `tests/scenario/test_agreement.py`",
    ),
    (
        "Files that come from outside are regular ones, measured before they are read, and bounded in what they can "
        "ask for; every number of a setting is 0 or of a size from 1e-30 to 1e30, counts and times are bounded.",
        "Pipes, devices, links, sparse files, nesting and integers without end, headers that lie, for every reader; "
        "every numeric field of every table at the ends of its range; each case in a process with 2 GiB of addresses "
        "and 20 s, a death or a hang being a failure.",
        "`tests/inputs/test_files.py`, `tests/inputs/test_settings.py`, `tests/benchmarks/test_fuzz.py`",
    ),
    (
        "A run whose trace goes into a file leaves what there was, whatever ends it: an interrupt, a defect, a full "
        "disk; of a killed process all but the last block of 5000 ticks. A finished run of a sweep is done "
        "again only if its own file is damaged.",
        "Exceptions of every kind, SIGKILL and SIGTERM in the middle of runs; bytes of any file of a sweep's, a "
        "study's and an interrupted run's folder changed, cut, inserted or taken away.",
        "`tests/trace/test_writer.py`, `tests/benchmarks/sweeps/test_store.py`, `tests/benchmarks/test_fuzz.py`",
    ),
)  # fmt: skip

LIMITS = """\
- A solver that never comes back is not interrupted: it runs in the control process, and its lateness is seen when it
  returns. A solver's own time limit is what bounds it; a watchdog that cuts the drives belongs in the arm's own
  controller.
- A solver of a third party is code that its user installed: its own options are its own matter, and no allow-list is
  kept for it. A TOML may name any URDF and `replay_us` any .npy file to be read.
- The two engines are compared at the home pose and two others; what both drop alike (shapes, extensions of the format,
  `<dynamics>`, whose place is the robot's TOML) is left out of the arm.
- The residual check looks along one line. On an arm with one elbow swivel this is the whole feasible set; with several
  freedoms it is the steepest way down that the box leaves open at the answer. A wrong end is seen there; how much is
  lost across that line is not.
- A lie whose answer is the optimum all the same, because the box leaves nothing else or the gradient is zero along the
  self-motion, is not refused: it does no harm. Such answers are counted as harmless, by the judge that also verifies
  honest ones, not by the supervisor.
- With a solver that is faulty at every tick no third level is left: the arm then does what tip and RCM control with a
  damped self-motion do, manipulability is not raised, and the RCM error is that of the poses it passes, some percent
  more or less than on the way that the third level would have taken. Joints are kept off their limits only where some
  self-motion does it; where none does, the guard's wall acts.
- Delay: the default and the `tuned` gains bear three ticks from command to torque (6 ms); with four the loop of
  `tuned` is unstable and the guard stops it. The preset `robust` bears four, at half as much tip error again.
- Limits on the incision, and what they stand on: over 44 sound runs of `default`, `tuned`, `robust`, `rnn` and DCAC
  on four paths the largest mean is 0.1 to 4.0 mm of RCM error and 0.5 to 3.2 N; over 20 with the paper's parameters
  3.9 to 9.0 mm and 3.1 to 7.1 N, so that these may warn. Arms that stand at a joint's wall had 8 to 33 mm and 6 to 26
  N, and used to complete; a trocar that slips by 100 mm gives 80 N and leaves the registered error at 4 mm, which is
  why the force has a limit of its own. In the stop the tissue pushes the arm back: within half a second 10.5 N
  fall to 4 N, where the brakes close, while the tip moves by 15 mm.
- The trocar's force is told from what the tip touches by the moment at the tool's mount; nearer than 50 mm to the tip
  it is not, and all that acts across the shaft counts. An unknown weight on the tool counts as the trocar's too (10 N
  for 1 kg on a level tool), and so does the tool's inertia force (0.3 N for each m/s^2).
- Oscillation is found after the run, above 8 Hz, in what a joint keeps up for a second: 0.2 rad/s or 10 Nm
  (`moc_opt/trace/oscillation.py` has the figures on both sides). With the paper's rho = 0 the answer jumps between
  vertices; where that shakes the arm it is reported as what it is. While the arm runs, only the limits above act.
- A solver runs in the control process: it gets copies and its answers are copied, but nothing keeps foreign code from
  looking through the interpreter's memory. Code that means harm belongs into a process of its own.
- Packets lost at random: at 10 % one run of 6 s in four meets four lost ones in a row, which is a stop.
- What no measurement shows is not seen. An encoder's bias, and a drift that its velocity shares, move the tip with
  it; the trocar's force alone tells (20 mrad/s on all joints: 48 mm and 20 N at most over 25 runs, three of them to
  their end). One stuck encoder is found by its joint's momentum or by that force: over 72 runs in the median after
  0.3 s, at worst after 2 s; the second joint's, which carries most weight, may cost 260 mm and 84 N, the others' 95
  mm and 52 N, and six runs went on to their end. Old packets under new numbers are seen where they begin, if the
  arm moved, and within 26 ticks if it rested: their noise came before, to the last bit (40 runs at rest: tip 0.8 mm
  and 0.8 N at most; before this check 1.1 m and 163 N). Without noise of the wrench sensor those of an arm at rest
  are not told from rest. A lag under forged numbers: 61 mm and 51 N at worst of 43 runs.
- The levels of these checks were chosen on random scenarios (friction from none to twice, 0 to 3 ticks of delay,
  masses 20 % wrong, calibration 1 mm, payloads to 0.8 kg, encoders coarse, noisy or exact, all presets) and judged
  on 230 others: none was stopped by them that would have ended well. Two false stops in 845 runs before that had
  raised two of the levels.
- A momentum residual cannot tell a hard, sudden push from a sensor's lie: what changes a joint's torque by a fifth of
  its largest within a quarter of a second is a stop. A push of 30 N on the elbow is not.
- A stop gives way to the tissue by the damping of its drives alone. A trocar that slips by 100 mm within 0.1 s
  presses with 45 N when the stop is ordered and with up to 72 N while it goes on moving; after half a second 2 to
  16 N are left. Less damping changes that by a tenth: the arm's inertia decides. Of 120 runs with two to five
  faults at once the worst had 56 N.
- What feels like a trocar's force above `stop_yield_N` opens the brakes: an unknown load of 3 kg on the tool then
  sinks by 45 mm, one of 5 kg by 145 mm (both are beyond the force's limit, so that no run with them lasts). Drives
  that cannot carry the weight keep their brakes closed.
- Speed limits are kept by braking what is too fast, not by foresight: full torque in the wrong direction exceeds them
  for some ticks.
"""


def page(found: Mapping[str, Any]) -> str:
    """The page as text, from the figures of one run (``cases``, ``goals``, ``environment``)."""
    cases, goals, where = found["cases"], found["goals"], found["environment"]
    config, machine = where["config"], where["machine"]
    parts = [
        "# Reliability",
        "What is promised when something goes wrong, how each promise is tested, and what a run of the fault benchmark "
        "found. This page is written by `python -m benchmarks.faults --page` and `python -m benchmarks.fuzz --page`; "
        "do not edit it.",
        "## Promises",
        "\n".join(f"{i}. **{text}** Tested: {how} ({file})" for i, (text, how, file) in enumerate(PROMISES, 1)),
        "## Limits of these promises",
        LIMITS.rstrip(),
        "## Figures",
        headline(cases, goals),
        f"{config['trials']} trials of {config['scenario']['duration_s']:g} s, seed {where['seed']}; "
        f"Python {machine['python']}, {machine['cores']} cores. A run survives when it completes with a tip error of "
        f"at most {config['tip_limit_mm']:g} mm and an RCM error of at most {config['rcm_limit_mm']:g} mm throughout. "
        "No figure here is a time of computation: hanging solvers are replayed times.",
        "### Goals",
        markdown(GOALS, goals),
        "### Solver faults: injected and detected",
        markdown(SEEN, by_group(cases).get("solver", [])),
    ]  # fmt: skip
    if "fuzz" in found:
        sent = found["fuzz"]
        parts += [
            "### Bad input",
            f"`python -m benchmarks.fuzz --cases {sent['cases']} --seed {sent['seed']} --page`. Accepted: it ran, and "
            "what came of it is right; refused: with a message that names the field or the file.",
            markdown(COUNTS, [{"kind": kind, **sent["kinds"][kind]} for kind in sorted(sent["kinds"])]),
        ]
    groups = by_group(cases)
    for group, rows in ((name, groups[name]) for name in TITLES if name in groups):
        parts += [f"### Worst of the trials: {TITLES[group]}", markdown(CASES, rows)]
    return "\n\n".join(parts) + "\n"


TITLES = {
    "none": "no fault", "solver": "solver", "sensors": "sensors and packets", "plant": "plant and delay",
    "contact": "bumps and trocar", "camera": "camera",
}  # fmt: skip


def write_page(found: Mapping[str, Any], path: Path = PAGE) -> None:
    """The page, and beside it the figures that it was made from; those of another command stay as they are.

    Raises:
        ScenarioError: the figures of the faults are not there yet.
    """
    figures = path.with_suffix(".json")
    old = json.loads(figures.read_text(encoding="utf-8")) if figures.exists() else {}
    if "cases" not in {**old, **found}:
        raise ScenarioError(f"{figures}: no figures yet; run python -m benchmarks.faults --page first")
    output.write_json(figures, {**old, **found})
    # of the file, not of what it was written from: whoever reads it must come to the same page
    output.write_atomically(path, page(json.loads(figures.read_text(encoding="utf-8"))).encode())
