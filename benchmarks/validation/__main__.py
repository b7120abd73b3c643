"""Compare the water, the muscles and the sizes of fish with published measurements that nothing was fitted to.

    python -m benchmarks.validation            every comparison, one after another (five minutes)
    python -m benchmarks.validation --draw     the charts again

Each can be run by itself: python -m benchmarks.validation.lamprey.
"""

from benchmarks.common.charts import measure_and_draw
from benchmarks.validation import coasting, eel, lamprey, robot, sizes, strength, torque

CASES = (lamprey, eel, torque, robot, coasting, strength, sizes)


def main() -> None:
    """The command line."""

    def each(what: str) -> None:
        for case in CASES:
            getattr(case, what)()

    measure_and_draw(__doc__, lambda: each("measure"), lambda: each("draw"))


if __name__ == "__main__":
    main()
