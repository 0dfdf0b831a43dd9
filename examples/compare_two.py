"""Print the metrics of two solvers side by side, in the same controller on the same trial.

python examples/compare_two.py [exact] [rnn]
"""

import sys

import moc_opt as mo

first, second = [*sys.argv[1:], "exact", "rnn"][:2]
trial = mo.Scenario(seed=1, start={"swivel": "random"})
baseline = mo.run(trial.change(control={"law": "dcac"}))
runs = {name: mo.run(trial.change(solver={"name": name, "settings": {}})) for name in (first, second)}
for name, trace in runs.items():
    print(f"{name} {trace.meta['ended']}")
results = [mo.summarize(trace, baseline) for trace in runs.values()]
print(f"{'metric':30s}" + "".join(f"{name:>14s}" for name in runs))
for metric in results[0]:
    print(f"{metric:30s}" + "".join(f"{result.get(metric, float('nan')):14.4g}" for result in results))
