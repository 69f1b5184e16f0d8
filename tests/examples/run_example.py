"""Runs an example as a script: saves its figures and prints what some expressions are at its end.

Usage: run_example.py EXAMPLE FOLDER EXPRESSIONS, the last a JSON object of Python expressions by
name. Prints their values as JSON in the last line.
"""

import json
import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

example, folder, expressions = sys.argv[1], Path(sys.argv[2]), json.loads(sys.argv[3])
sys.argv = [example]
space = runpy.run_path(example, run_name="__main__")

empty, unlabelled = [], []
for number in plt.get_fignums():
    figure = plt.figure(number)
    figure.savefig(folder / f"figure_{number}.png", facecolor=figure.get_facecolor())
    for axes in figure.axes:
        what = f"figure {number}, axes {axes.get_title() or axes.get_ylabel()!r}"
        lines = [np.asarray(line.get_ydata(), dtype=float) for line in axes.lines]
        if any(not np.isfinite(values).any() for values in lines) or not axes.has_data():
            empty.append(what)
        if not axes.get_ylabel():
            unlabelled.append(what)
space |= {"folder": folder, "np": np}
values = {
    name: np.asarray(eval(expression, space)).tolist() for name, expression in expressions.items()
}
print(json.dumps({"empty": empty, "unlabelled": unlabelled, "values": values}))
