"""What stands between a fish and its controller: noise, delays and a memory of observations and actions.

Everything is off by default, and then no kernel knows of it. Legend: b fish; i number of an observation; a action; k
environment steps ago; D numbers of one observation, F observations and K actions that are remembered.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fish_env.checks import check_names, is_whole
from fish_env.envs.layout import Layout
from fish_env.kernels.compile import INDEX, kernel
from fish_env.kernels.simd import Pack
from fish_env.tasks.options import Option

ACTION_STANDARD = Option(0.0, 2.0, "standard deviation of an action, of which -1 is relaxed and 1 contracted")
LONGEST_DELAY, LONGEST_HISTORY = 1000, 100  # environment steps
DEVIATES = 2**16
"""Length of the table of normal deviates; noise is read from a place in it that is drawn for each fish and step."""
WORD = 2**32 - 1
OBSERVED, ACTED = 0, 1  # the two streams of noise, and the two delays


class Senses(NamedTuple):
    """Checked settings."""

    observation_noise: Mapping[str, float]
    action_noise: float
    observation_delay: tuple[int, int]
    action_delay: tuple[int, int]
    history: int

    @property
    def noisy(self) -> bool:
        return self.action_noise > 0.0 or any(self.observation_noise.values())

    @property
    def remember(self) -> bool:
        """True if kernels need a memory: anything is not as by default."""
        return self.noisy or self.history > 0 or self.observation_delay[1] > 0 or self.action_delay[1] > 0


def checked_senses(observation_noise, action_noise, observation_delay, action_delay, history) -> Senses:
    """The settings of these keywords; ValueError for what is not allowed, saying what is."""
    # `check_delays` compares the delays with a time limit, `checked_noise` the noise with a layout.
    if not isinstance(observation_noise, Mapping | None):
        raise ValueError(f"observation_noise is {observation_noise!r}; give a dict: a standard deviation for each part")
    if not (is_whole(history) and 0 <= history <= LONGEST_HISTORY):
        raise ValueError(f"history is {history!r}; give a whole number of steps from 0 to {LONGEST_HISTORY}")
    return Senses(
        dict(observation_noise or {}), ACTION_STANDARD.checked("action_noise", action_noise),
        checked_delay("observation_delay", observation_delay), checked_delay("action_delay", action_delay),
        int(history),
    )  # fmt: skip


def check_delays(senses: Senses, limit: int | None) -> None:
    """ValueError unless the delays are shorter than an episode of so many environment steps; None: no limit."""
    for name in ("observation_delay", "action_delay"):
        low, high = getattr(senses, name)
        checked_delay(name, low if low == high else (low, high), limit)


def checked_delay(name: str, value: Any, limit: int | None = None) -> tuple[int, int]:
    """A delay as a pair (lowest, highest) of environment steps, shorter than an episode; else ValueError."""
    pair: Any = (value, value)
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) and getattr(value, "ndim", 1):
        pair = tuple(value)
    most = LONGEST_DELAY if limit is None else min(limit - 1, LONGEST_DELAY)
    if len(pair) != 2 or not all(is_whole(each) for each in pair) or not 0 <= pair[0] <= pair[1] <= most:
        raise ValueError(
            f"{name} is {value!r}; give a whole number of environment steps from 0 to {most}, or a pair "
            f"(lowest, highest){'' if limit is None else f': an episode has {limit} steps'}"
        )
    return int(pair[0]), int(pair[1])


def checked_noise(senses: Senses, layout: Layout) -> Senses:
    """The settings with noise as numbers; ValueError for a part that is not there, or noise beyond a part's bound."""
    parts, noise = {part.name: part for part in layout.parts[: layout.num_present]}, {}
    for name, value in senses.observation_noise.items():
        check_names("observation_noise has", parts, name)
        option = Option(0.0, parts[name].limit, f"standard deviation, {parts[name].unit}")
        noise[name] = option.checked(f"observation_noise[{name!r}]", value)
    return senses._replace(observation_noise=noise)


def make_memory(senses: Senses, layout: Layout, num_envs: int, num_actions: int) -> dict[str, np.ndarray]:
    """Arrays of the memory of B fish, by name."""
    from scipy.special import ndtri  # half a tenth of a second, only where there is noise

    deviates = np.random.default_rng(0).permutation(ndtri((np.arange(DEVIATES) + 0.5) / DEVIATES))
    noise = np.zeros(layout.present, dtype=np.float32)
    for name, value in senses.observation_noise.items():
        noise[layout[name].slice] = value
    frames = senses.observation_delay[1] + senses.history + 1
    return {
        "past_observation": np.zeros((num_envs, frames, layout.present), dtype=np.float32),
        "past_action": np.zeros((num_envs, max(senses.action_delay[1], senses.history) + 1, num_actions)),
        "delay": np.zeros((num_envs, 2), dtype=np.int64),
        "key": np.zeros(num_envs, dtype=np.int64),
        "noise": noise,
        "bound": layout.bounds()[: layout.present],
        "deviates": np.pad(deviates, (0, layout.present), mode="wrap").astype(np.float32),
    }


def draw_delays(senses: Senses, memory: Mapping[str, np.ndarray], i: int, generator: np.random.Generator) -> None:
    """Draw the delays of the next episode of fish i and the key of its noise."""
    for which, (low, high) in ((OBSERVED, senses.observation_delay), (ACTED, senses.action_delay)):
        memory["delay"][i, which] = generator.integers(low, high + 1) if low < high else low
    if senses.noisy:
        memory["key"][i] = generator.integers(WORD)


def pack_memory(senses: Senses, memory: Mapping[str, np.ndarray]) -> Pack:
    """The memory as kernels read it."""
    return Pack("memory", **memory, history=senses.history, action_noise=float(senses.action_noise))


@kernel
def mix(word):
    """Scramble a word of 32 bits, reversibly (C. Wellons, lowbias32)."""
    word = ((word ^ (word >> 16)) * 0x7FEB352D) & WORD
    word = ((word ^ (word >> 15)) * 0x846CA68B) & WORD
    return word ^ (word >> 16)


@kernel
def noise_place(key, step, stream):
    """Place in the table of deviates from which a stream of noise is read in an environment step."""
    return mix(mix((int(key) + stream) & WORD) ^ int(step)) & (DEVIATES - 1)


@kernel
def recall_action(env, b):
    """Remember the action of fish b, and set its contractions from the one that arrives now, with noise."""
    episode, memory = env.episode, env.memory
    past, now, groups = memory.past_action, episode.elapsed[b], episode.groups
    kept, then = past.shape[1], now - memory.delay[b, ACTED]
    slot, source = INDEX(now % kept), INDEX(then % kept)
    for a in range(past.shape[2]):
        past[b, slot, INDEX(a)] = min(max(episode.action[b, INDEX(a)], -1.0), 1.0)
    place = noise_place(memory.key[b], now, ACTED)
    for m in range(groups.size):
        a = groups[m]
        arriving = past[b, source, INDEX(a)] if then >= 0 else -1.0
        arriving += memory.action_noise * memory.deviates[INDEX(place + a)]
        episode.contraction[b, m] = 0.5 * (min(max(arriving, -1.0), 1.0) + 1.0)


@kernel
def recall_observation(env, b):
    """Remember what fish b observes, with noise, and fill its row with what arrives: late, and with its past."""
    # Before the beginning of the episode, the first observation was observed, and the muscles were relaxed.
    memory, out, now = env.memory, env.rows.observation, env.episode.elapsed[b]
    past, acted = memory.past_observation, memory.past_action
    frames, width, kept, actions = past.shape[1], past.shape[2], acted.shape[1], acted.shape[2]
    slot, place = INDEX(now % frames), noise_place(memory.key[b], now, OBSERVED)
    for i in range(width):
        noisy = out[b, INDEX(i)] + memory.noise[INDEX(i)] * memory.deviates[INDEX(place + i)]
        past[b, slot, INDEX(i)] = min(max(noisy, -memory.bound[INDEX(i)]), memory.bound[INDEX(i)])
    start = 0
    for k in range(memory.history + 1):
        then = max(now - memory.delay[b, OBSERVED] - k, 0)
        slot = INDEX(then % frames)
        for i in range(width):
            out[b, INDEX(start + i)] = past[b, slot, INDEX(i)]
        start += width
        if k < memory.history:
            when = now - 1 - k
            slot = INDEX(when % kept)
            for a in range(actions):
                out[b, INDEX(start + a)] = acted[b, slot, INDEX(a)] if when >= 0 else -1.0
            start += actions
