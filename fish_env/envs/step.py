"""One environment step as one compiled call: command, integrate, measure, reward, observe.

What a fish observes and remembers is a tuple `senses`, by which kernels are kept: the kernel that observes; whether
actions and observations pass through a memory; whether all nodes are observed besides, for a privileged critic.

Legend: b fish; t terms of the reward; p place of a fish in the order in which its thread moves it.
"""

import math
from functools import cache

import numpy as np

from fish_env.envs.observation import observe_nodes
from fish_env.envs.senses import recall_action, recall_observation
from fish_env.kernels.compile import INDEX, kernel, njit, part
from fish_env.kernels.simd import dot, pack_at, sqrt
from fish_env.physics.engine import make_advance
from fish_env.physics.forces import cached
from fish_env.physics.muscles import command
from fish_env.physics.pose import measure

FAILURE_PENALTY = 10.0  # body lengths: what a failure of the physics costs


@kernel
def contract(action, groups, b, out):
    """Contractions (B,M) in [0, 1] of fish b for actions (B,A) clipped to [-1, 1]; False, and void, if not finite."""
    for m in range(groups.size):
        wanted = action[b, INDEX(groups[m])]
        if not math.isfinite(wanted):
            return False
        out[b, m] = 0.5 * (min(max(wanted, -1.0), 1.0) + 1.0)
    return True


@kernel
def measure_motion(env, b, stepped):
    """Measure the pose of fish b; after a step, add the way of its centre of mass to its path."""
    tank, pose = env.tank, env.pose
    before = pose.centre[b]
    measure(tank, pose, b)
    if stepped and tank.failure[b] == 0:
        way = pose.centre[b] - before
        env.episode.path[b] += sqrt(dot(way, way))


@cache
def make_observe(senses):
    """The kernel `(env, b)` that fills what fish b observes, from its pose and the vectors of its task."""
    observe, remember, privileged = senses

    @kernel
    def observe_all_of(env, b):
        observe(env, env.rows, b)
        if remember:
            recall_observation(env, b)
        if privileged:
            observe_nodes(env, env.privileged, b)

    return observe_all_of


@cache
def make_measure_and_observe(kernels, senses):
    """The kernel `(env, first, last, stepped)` for a task's kernels (look, score), or without a task for None."""
    # It measures the fish queue.order[first:last], rewards them if they have stepped, and fills their observations.
    # Without a task it only measures.
    if kernels is None:

        @part
        def measure_and_observe(env, first, last, stepped):
            for p in range(first, last):
                measure_motion(env, INDEX(env.order[p]), stepped)

        return measure_and_observe

    observe = make_observe(senses)
    look, score = kernels

    @kernel
    def compute_reward_and_end(env, b):
        tank, episode = env.tank, env.episode
        terms, failed = episode.terms, tank.failure[b] != 0
        score(tank, env.pose, env.task, b, terms)
        last = terms.shape[0] - 1
        terms[last, b] = -episode.failure_penalty[0] if failed else 0.0
        total = 0.0
        for t in range(last + 1):
            total += terms[t, b]
            episode.totals[t, b] += terms[t, b]
        episode.reward[b] = total
        episode.elapsed[b] += 1
        over = failed or env.task.over[b]
        episode.terminated[b] = over
        episode.truncated[b] = not over and episode.elapsed[b] >= episode.limit[b]

    @part
    def measure_and_observe(env, first, last, stepped):
        for p in range(first, last):
            b = INDEX(env.order[p])
            measure_motion(env, b, stepped)
            if stepped:
                compute_reward_and_end(env, b)
            look(env.tank, env.pose, env.task, b, env.episode.vectors)
            observe(env, b)

    return measure_and_observe


@cache
def compile_measure_and_observe(kernels, senses):
    """`make_measure_and_observe`, compiled for Python to call."""
    measure_and_observe = make_measure_and_observe(kernels, senses)

    @njit
    def call(env, first, last, stepped):
        measure_and_observe(env, first, last, stepped)

    return call


@cache
def compile_observe(senses):
    """`make_observe` for all fish, compiled for Python to call."""
    observe = make_observe(senses)

    @njit
    def observe_all(env):
        for b in range(env.episode.reward.size):
            observe(env, b)

    return observe_all


@njit
def recall_all(env):
    """Replace the contractions of all fish by those of the actions that arrive."""
    for b in range(env.episode.reward.size):
        recall_action(env, b)


@njit
def contract_all(env):
    """Fill the contractions of all fish; False, and void, unless all actions are finite."""
    episode = env.episode
    for b in range(episode.reward.size):  # noqa: SIM110 - a kernel
        if not contract(episode.action, episode.groups, b, episode.contraction):
            return False
    return True


@cached
def make_step(names: tuple[str, ...], make_run, kernels, senses, env_type):
    """The compiled `step(address, first, last, n, duration)` for an environment's pack of this type, by its address."""
    # It returns False, and nothing has moved, for an action that is not finite. With n below zero it only measures and
    # observes the fish where they are: one compilation serves resets and steps.
    advance, env_at = make_advance(names, make_run), pack_at(env_type)
    measure_and_observe, remember = make_measure_and_observe(kernels, senses), senses[1]

    @njit
    def step(address, first, last, n, duration):
        env = env_at(address)
        episode, order = env.episode, env.order
        if n >= 0:
            for p in range(first, last):
                if not contract(episode.action, episode.groups, INDEX(order[p]), episode.contraction):
                    return False
            if remember:
                for p in range(first, last):
                    recall_action(env, INDEX(order[p]))
            for p in range(first, last):
                command(env.tank, episode.contraction, INDEX(order[p]), duration)
            advance(env.tank, env.queue, env.block, first, last, n)
        measure_and_observe(env, first, last, n >= 0)
        return True

    return step


def make_arrays(num_envs: int, num_terms: int, groups: np.ndarray, numbers: int) -> dict[str, np.ndarray]:
    """Arrays of the state of the episodes, by name, with a row or a column for each fish."""
    b = num_envs
    return {
        "action": np.zeros((b, int(groups.max()) + 1)),
        "groups": np.array(groups),  # the kernels' own: they do not check that a muscle exists
        "contraction": np.zeros((b, groups.size)),
        "observation": np.zeros((b, numbers), dtype=np.float32),
        "terms": np.zeros((num_terms + 1, b)),
        "totals": np.zeros((num_terms + 1, b)),
        "failure_penalty": np.array([FAILURE_PENALTY]),
        "path": np.zeros(b),
        "reward": np.zeros(b),
        "terminated": np.zeros(b, dtype=bool),
        "truncated": np.zeros(b, dtype=bool),
        "elapsed": np.zeros(b, dtype=np.int64),
        "limit": np.zeros(b, dtype=np.int64),
    }
