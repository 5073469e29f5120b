"""Table of docs/how-to/learning.md: a learned UAV beside the paper's laws, in runs outside its training.

python examples/evaluate_uav.py --json table.json --curve learning-curve.png
"""

import argparse
import json
from pathlib import Path

from curve import draw_curve
from evaluation import CASES, as_dicts, evaluate, markdown

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument(
    "policy", type=Path, nargs="?", default=Path(__file__).parent / "policies" / "uav_ppo.npz"
)
parser.add_argument("--flights", type=int, default=20, help="Runs per pilot and case.")
parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
parser.add_argument("--json", type=Path, help="Also write the table to this file.")
parser.add_argument("--curve", type=Path, help="Plot the learning curve into this PNG.")
given = parser.parse_args()
try:
    results = evaluate(given.policy, flights=given.flights, cases=given.cases)
    if given.curve is not None:
        draw_curve(given.policy, given.curve)
except ValueError as error:
    parser.error(str(error))
print(markdown(results))
if given.json is not None:
    given.json.write_text(json.dumps(as_dicts(results), indent=1) + "\n", encoding="utf-8")
