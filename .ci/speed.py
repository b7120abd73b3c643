"""A fixed short measurement of speed, for every commit, and what is drawn of it.

python .ci/speed.py speed.json

Time of a control interval of the default fish in the batches of `benchmarks.speed.throughput`, alone and one of many,
and its ratio to a fish alone. Processors of rented machines differ: compare ratios. They go to drawn.json too, for the
chart over commits, with the share of lines that no test reaches where a coverage.json lies beside.
"""

import json
import sys
from pathlib import Path

from benchmarks.common.tables import TRAJECTORIES, provenance
from benchmarks.speed.throughput import intervals

if __name__ == "__main__":
    times = {name.removesuffix(", us"): float(each) for name, each in intervals()}
    alone = next(iter(times.values()))
    about = {key: text for key, text in provenance("python .ci/speed.py").items() if key != TRAJECTORIES}
    us, ratios = ({name: round(each / by, 4) for name, each in times.items()} for by in (1.0, alone))
    drawn = [{"name": name, "unit": "of a fish alone", "value": each} for name, each in list(ratios.items())[1:]]
    target = Path(sys.argv[1])
    coverage = target.with_name("coverage.json")
    if coverage.exists():
        reached = json.loads(coverage.read_text("utf-8"))["totals"]["percent_covered"]
        drawn.append({"name": "lines that no test reaches", "unit": "%", "value": round(100.0 - reached, 2)})
    for path, found in ((target, about | {"us": us, "ratio": ratios}), (target.with_name("drawn.json"), drawn)):
        path.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(ratios, indent=2))
