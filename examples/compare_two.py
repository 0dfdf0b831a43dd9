"""Two solvers in the same controller on the same trial: what differs?

python examples/compare_two.py [exact] [rnn]
"""

import sys

import moc_opt as mo

first, second = [*sys.argv[1:], "exact", "rnn"][:2]
trial = mo.Scenario(seed=1, start={"swivel": "random"})
baseline = mo.run(trial.change(control={"law": "dcac"}))
results = [
    mo.summarize(mo.run(trial.change(solver={"name": name, "settings": {}})), baseline)
    for name in (first, second)
]
print(f"{'metric':28s}{first:>14s}{second:>14s}")
for metric in sorted(set(results[0]) & set(results[1])):
    print(f"{metric:28s}{results[0][metric]:14.4g}{results[1][metric]:14.4g}")
