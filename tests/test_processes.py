"""Fish in company: forked processes, object stores, threads."""

import gc
import os
import pickle
import signal
import threading
import weakref

import gymnasium as gym
import numpy as np
import pytest

from fish_env import TASKS, Tank, make_fish
from fish_env.envs import FishVectorEnv


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_forked_process_has_threads_of_its_own():
    """A batch that used two threads goes on in a forked process and in its parent, to the same bits."""
    fish = make_fish()
    tank = Tank(fish, 64, water=fish.water, threads=2)
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 64, 12))
    tank.swim(action[0], fish.control_interval)
    read, write = os.pipe()
    child = os.fork()
    if not child:  # the alarm ends it if it waits for threads that it does not have
        signal.alarm(60)
        tank.swim(action[1], fish.control_interval)
        os.write(write, tank.position.tobytes()[:4096])
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert status == 0
    tank.swim(action[1], fish.control_interval)
    assert os.read(read, 4096) == tank.position.tobytes()[:4096]
    os.close(read)
    os.close(write)
    tank.close()


def test_a_dropped_batch_is_freed():
    """A batch of two threads that is dropped without `close` leaves neither memory nor threads behind."""
    others = set(threading.enumerate())
    env = gym.make_vec("FishEnv/Swim-v0", num_envs=64, threads=2)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    tank, workers = weakref.ref(env.unwrapped.tank), set(threading.enumerate()) - others
    assert len(workers) == 2
    del env
    gc.collect()
    assert tank() is None
    for worker in workers:
        worker.join(timeout=60)
        assert not worker.is_alive()


def from_store(thing):
    """A thing pickled with its arrays aside, and read back with arrays that must not be written to."""
    buffers = []
    data = pickle.dumps(thing, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[bytes(buffer) for buffer in buffers])


@pytest.mark.parametrize("task", TASKS)
def test_environments_out_of_an_object_store(task):
    """An environment out of an object store, whose arrays are read-only, steps and restarts as the original does."""
    env = FishVectorEnv(3, task=task, max_episode_steps=4)
    env.reset(seed=5)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (7, *env.action_space.shape)).astype(np.float32)
    for action in actions[:2]:
        env.step(action)
    other = from_store(env)
    for action in actions[2:]:  # beyond the end of the episodes
        for one, same in zip(env.step(action)[:4], other.step(action)[:4], strict=True):
            np.testing.assert_array_equal(one, same)
    env.close()
    other.close()


def test_a_single_environment_out_of_an_object_store():
    """The same for `gym.make`, with what Gymnasium wraps around it."""
    env = gym.make("FishEnv/Target-v0").unwrapped
    env.reset(seed=2)
    other = from_store(env)
    action = np.full(env.action_space.shape, 0.5, np.float32)
    for _ in range(3):
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])
    np.testing.assert_array_equal(env.reset(seed=4)[0], other.reset(seed=4)[0])
