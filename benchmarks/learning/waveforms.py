"""How much faster could any steady stroke swim than the best sinusoidal gait? A search over periodic waveforms.

    python -m benchmarks.learning.waveforms     writes results/waveforms.csv

Each segment's muscles follow a Fourier series in the phase of the beat, cut off at fully relaxed and fully contracted;
the right side is half a beat behind the left one. More harmonics can do all that fewer can. Speed is the distance from
start to end over the 5 s of an episode of Swim-v0 from rest, along the line that the fish takes: what a policy that
repeats its strokes could reach, with nothing lost to steering.
"""

import argparse

import numpy as np
from tqdm import tqdm

from benchmarks.common.tables import write_csv
from fish_env import Tank, make_fish
from fish_env.control import best_gait

SECONDS, POPULATION = 5.0, 24


def stroke(parameters: np.ndarray, harmonics: int, fish, time: float) -> np.ndarray:
    """Contractions (B,M) at `time` for B waveforms (B,P): the frequency, then 1 + 2 harmonics for each segment."""
    series = parameters[:, 1:].reshape(len(parameters), 3, 1 + 2 * harmonics)
    order = np.arange(1, harmonics + 1)
    sides = []
    for shift in (0.0, np.pi):
        phase = 2 * np.pi * parameters[:, :1] * time + shift
        waves = np.concatenate([np.ones_like(phase), np.sin(phase * order), np.cos(phase * order)], axis=1)
        sides.append((series * waves[:, None]).sum(axis=2))
    pairs = np.clip(np.stack(sides, axis=2), 0.0, 1.0)
    return pairs[:, fish.segments, np.where(fish.sides > 0, 0, 1)]


def speeds(candidates: np.ndarray, harmonics: int, fish) -> np.ndarray:
    """Distance between start and end over time, body lengths per second, forwards, of B waveforms; -1 for failures."""
    tank = Tank(fish, len(candidates), water=fish.water, threads=1)
    steps = round(fish.control_interval / fish.time_step)
    mass = fish.body.mass / fish.body.mass.sum()
    start = mass @ tank.position
    while tank.time[0] < SECONDS - 1e-9:
        tank.drive(stroke(candidates, harmonics, fish, tank.time[0] + fish.control_interval), steps)
    way = (mass @ tank.position - start) / fish.length / SECONDS
    ahead = np.sign((way * (fish.line @ tank.position)).sum(axis=1))
    return np.where(tank.alive, ahead * np.linalg.norm(way, axis=1), -1.0)


def from_gait(harmonics: int, fish) -> np.ndarray:
    """The best sinusoidal gait as a waveform."""
    gait = best_gait()
    series = np.zeros((3, 1 + 2 * harmonics))
    for k, (amplitude, lag) in enumerate(zip(gait.amplitude, gait.lag, strict=True)):
        series[k, 0] = 0.5 * amplitude
        series[k, 1], series[k, 1 + harmonics] = 0.5 * amplitude * np.cos(lag), -0.5 * amplitude * np.sin(lag)
    return np.concatenate([[gait.frequency], series.ravel()])


def main() -> None:
    """Search with one, two, three and four harmonics, each from the gait and from the best found with fewer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generations", type=int, default=150)
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    import cma

    fish, rows = make_fish(), []
    gait = speeds(from_gait(1, fish)[None], 1, fish)[0]
    for harmonics in (1, 2, 3, 4):
        for seed in range(arguments.seeds):
            start = from_gait(harmonics, fish)
            scale = np.concatenate([[0.5], np.full(start.size - 1, 0.15)])
            search = cma.CMAEvolutionStrategy(
                np.zeros(start.size), 1.0, {"popsize": POPULATION, "seed": seed + 1, "verbose": -9}
            )
            for _ in tqdm(range(arguments.generations), desc=f"{harmonics} harmonics, seed {seed}"):
                asked = search.ask()
                found = start + scale * np.array(asked)
                found[:, 0] = np.clip(found[:, 0], 1.0, 9.0)
                search.tell(asked, (-speeds(found, harmonics, fish)).tolist())
            best = -search.result.fbest
            beats = round(start[0] + scale[0] * search.result.xbest[0], 3)
            rows.append({"harmonics": harmonics, "seed": seed, "speed": round(best, 4),
                         "times_the_gait": round(best / gait, 4), "beats_a_second": beats})  # fmt: skip
            tqdm.write(str(rows[-1]))
    command = f"python -m benchmarks.learning.waveforms --seeds {arguments.seeds} --generations {arguments.generations}"
    print(write_csv("waveforms.csv", rows, command), f"the gait: {gait:.3f}")


if __name__ == "__main__":
    main()
