"""Environments in processes and threads: start methods, forks, other libraries' processes, one cache for all."""

import hashlib
import multiprocessing
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numba
import numpy as np
import pytest
from moving import tiered

from fish_env import Tank, make_fish
from fish_env.envs import FishVectorEnv
from fish_env.kernels import cache as _cache
from fish_env.kernels import compile as _jit
from fish_env.kernels.simd import Kind, Pack

METHODS = [name for name in ("fork", "spawn", "forkserver") if name in multiprocessing.get_all_start_methods()]
PATIENCE = 600  # s, after which a process that waits for ever is ended
COMPILING = """
import sys, numpy as np, fish_env
fish = fish_env.make_fish()
tank = fish_env.Tank(fish, 2, water=fish.water)
tank.swim(np.linspace(-1.0, 1.0, 12), fish.control_interval)
hits = sum(sum(call.stats.cache_hits.values()) for call in (tank._engine.compiled,))
print(tank.position.tobytes().hex()[:64], hits)
"""


def of_task(id, **options):
    """What makes an environment in another process."""
    return lambda: gym.make(f"fish_env:{id}", max_episode_steps=4, **options)


def played(env, actions):
    """All that a batch answers to actions, as bytes: observations, rewards and ends."""
    answers = [env.step(action)[:4] for action in actions]
    return [np.ascontiguousarray(part).tobytes() for answer in answers for part in answer]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("id", tiered(("FishEnv/Stub-v0", "FishEnv/Target-v0"), ("FishEnv/Stub-v0",)))
def test_gymnasium_in_processes(id, method):
    """Gymnasium's `AsyncVectorEnv`, by every start method, is its `SyncVectorEnv` bit for bit."""
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 2, 12)).astype(np.float32)
    made = [of_task(id)] * 2
    batches = gym.vector.AsyncVectorEnv(made, context=method), gym.vector.SyncVectorEnv(made)
    first = [batch.reset(seed=3)[0].tobytes() for batch in batches]
    one, other = (played(batch, actions) for batch in batches)
    for batch in batches:
        batch.close()
    assert first[0] == first[1] and one == other


@pytest.mark.parametrize("method", tiered(METHODS, ("fork",)))
@pytest.mark.parametrize("id", tiered(("FishEnv/Stub-v0", "FishEnv/Swim-v0"), ("FishEnv/Stub-v0",)))
def test_stable_baselines3_in_processes(id, method):
    """`SubprocVecEnv`, by every start method, is `DummyVecEnv` bit for bit."""
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 2, 12)).astype(np.float32)
    batches = vec_env.SubprocVecEnv([of_task(id)] * 2, method), vec_env.DummyVecEnv([of_task(id)] * 2)
    found = []
    for batch in batches:
        batch.seed(5)
        found.append([batch.reset().tobytes()])
        for action in actions:
            obs, reward, done, infos = batch.step(action)
            ends = [info.get("terminal_observation", np.zeros(0)).tobytes() for info in infos]
            found[-1] += [obs.tobytes(), reward.astype(np.float32).tobytes(), done.tobytes(), *ends]
        batch.close()
    assert found[0] == found[1]


def test_threads_of_python():
    """Four threads, each with a batch of its own, step at the same time as they would one after the other."""
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 3, 12))

    def play(seed):
        env = FishVectorEnv(3, max_episode_steps=6)
        return [env.reset(seed=seed)[0].tobytes(), *played(env, actions)]

    wanted = [play(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(play, range(4))) == wanted


@pytest.mark.slow
def test_threads_that_compile_at_once(tmp_path):
    """Threads that are the first to call the same kernel compile it once, and all get its result."""
    work = "import threading\ndef work():\n" + "".join(f"    {line}\n" for line in COMPILING.strip().splitlines())
    work += "threads = [threading.Thread(target=work) for _ in range(4)]\n"
    work += "[thread.start() for thread in threads]\n[thread.join() for thread in threads]\n"
    done = run(work.replace("print(", "print('', ").replace(", hits)", ")"), tmp_path)
    bits = done.stdout.split()
    assert len(bits) == 4 and len(set(bits)) == 1, done.stdout + done.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_process_forked_while_threads_step():
    """A process that is forked while other threads are in kernels steps its own environments."""
    fish, stop = make_fish(), threading.Event()
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (64, 12))

    def work():
        tank = Tank(fish, 64, water=fish.water, threads=2)
        while not stop.is_set():
            tank.swim(action, fish.control_interval)
        tank.close()

    tank = Tank(fish, 64, water=fish.water, threads=2)
    tank.swim(action, fish.control_interval)
    wanted = hashlib.sha256(tank.position.tobytes()).hexdigest()
    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        context = multiprocessing.get_context("fork")
        for _ in range(5):
            mine, theirs = context.Pipe(duplex=False)
            process = context.Process(target=forked, args=(fish, action, theirs))
            process.start()
            assert mine.poll(PATIENCE) and mine.recv() == wanted
            process.join()
    finally:
        stop.set()
        for thread in threads:
            thread.join()
        tank.close()


FORKING = """
import os, signal, threading
import numba
from fish_env.kernels.compile import njit

def long(count):
    lines = "".join(f"  t += x * {k}.0\\n  if t > {k}: t -= x\\n" for k in range(count))
    place = {}
    exec("def f(x):\\n  t = 0.0\\n" + lines + "  return t\\n", place)
    return numba.njit(place["f"])

begun, compiling = threading.Event(), long(40)
class Watch(numba.core.event.Listener):
    def on_start(self, event):
        begun.set()
    def on_end(self, event):
        pass

numba.core.event.register("numba:compile", Watch())
thread = threading.Thread(target=compiling, args=(1.0,))
thread.start()
begun.wait()
child = os.fork()
if not child:
    signal.alarm(100)
    os._exit(0 if njit(lambda x: 2.0 * x)(3.0) == 6.0 else 1)
print(os.waitpid(child, 0)[1])
thread.join()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_a_process_forked_while_a_thread_compiles(tmp_path):
    """A process that is forked while another thread compiles can compile too: it inherits no lock that is held."""
    assert run(FORKING, tmp_path).stdout.strip() == "0"


def forked(fish, action, pipe):
    """In a forked process: move fish with threads of its own."""
    tank = Tank(fish, 64, water=fish.water, threads=2)
    tank.swim(action, fish.control_interval)
    pipe.send(hashlib.sha256(tank.position.tobytes()).hexdigest())


def run(script, cache, **variables):
    """A script in a process of its own with a cache of its own."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "FISH_ENV_CACHE"))}
    variables = kept | {"NUMBA_CACHE_DIR": str(cache), "FISH_ENV_QUIET": "1"} | variables
    done = subprocess.run(
        [sys.executable, "-c", script], env=variables, capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.slow
def test_sixteen_processes_compile_at_once(tmp_path):
    """Sixteen processes that begin with an empty cache compile at once, agree, and leave it to the next."""
    with ThreadPoolExecutor(16) as pool:
        found = list(pool.map(lambda _: run(COMPILING, tmp_path), range(16)))
    bits = {done.stdout.split()[0] for done in found}
    assert len(bits) == 1 and not any(done.stderr for done in found)
    again = run(COMPILING, tmp_path)
    assert again.stdout.split() == [*bits, "1"] and not list(tmp_path.rglob("*.tmp*"))


def test_checks_of_bounds_have_a_cache_of_their_own(tmp_path, monkeypatch):
    """Kernels that check their bounds (NUMBA_BOUNDSCHECK=1) are never mistaken for those that do not."""
    monkeypatch.setattr(_cache, "_FOLDER", str(tmp_path))
    pack = Pack("numbers", a=np.arange(9.0)[:3], v=Kind().vectors(3))

    def made():
        @_jit.kernel
        def inner(pack, i):
            return pack.a[i] + pack.v[i].x

        @_jit.njit
        def read(pack, i):
            return inner(pack, _jit.INDEX(i))

        return read

    for checked in (None, 1, None, 1):
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", checked)
        read = made()
        assert read(pack, 2) == 2.0
        if checked:
            with pytest.raises(IndexError, match="out of bounds"):
                read(pack, 3)
    assert len(list(tmp_path.rglob("*.nbc"))) == 2 and sum(read.stats.cache_hits.values()) == 1
