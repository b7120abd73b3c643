"""A fixed short measurement of speed, for every commit.

python .ci/speed.py speed.json

Time of a control interval of the default fish in the batches of `benchmarks.speed.throughput`, alone and one of many,
and its ratio to a fish alone. Processors of rented machines differ: compare ratios.
"""

import json
import sys
from pathlib import Path

from benchmarks.common.tables import TRAJECTORIES, provenance
from benchmarks.speed.throughput import intervals

if __name__ == "__main__":
    times = dict(intervals())
    alone = next(iter(times.values()))
    about = {key: text for key, text in provenance("python .ci/speed.py").items() if key != TRAJECTORIES}
    ratios = {name.removesuffix(", us"): round(float(each / alone), 4) for name, each in times.items()}
    found = about | {"us": {name.removesuffix(", us"): round(float(each), 3) for name, each in times.items()}}
    Path(sys.argv[1]).write_text(json.dumps(found | {"ratio": ratios}, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(ratios, indent=2))
