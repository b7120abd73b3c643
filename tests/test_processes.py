"""Threads, processes that are forked, spawned or killed, object stores and memory; the same bits in all."""

import gc
import hashlib
import json
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import count

import gymnasium as gym
import numpy as np
import pytest
from gliding import ID, GlidingVectorEnv, each_way
from moving import tiered
from pages import ROOT

from fish_env import BODIES, TASKS, Tank, checks, make_fish
from fish_env.control import load_policy
from fish_env.envs import FishVectorEnv
from fish_env.envs.layout import bytes_of_episode
from fish_env.kernels.compile import kernel, njit
from fish_env.kernels.threads import Threads, defer_signals
from fish_env.physics.tank_options import bytes_of
from fish_env.soft.objects import OBJECTS
from fish_env.training.run_folder import CURVE, read_curve

NAMES = [id.partition("/")[2][:-3] for id in ID.values()]
METHODS = [name for name in ("fork", "spawn", "forkserver") if name in multiprocessing.get_all_start_methods()]
needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
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
@pytest.mark.parametrize("id", tiered(("FishEnv/Stub-v0", "FishEnv/Swim-v0"), ("FishEnv/Stub-v0",)))
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
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (10, 2, 12))

    def play(seed):
        env = FishVectorEnv(2, max_episode_steps=6)
        return [env.reset(seed=seed)[0].tobytes(), *played(env, actions)]

    wanted = [play(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(play, range(4))) == wanted


@needs_fork
def test_a_process_forked_while_threads_step():
    """A process that is forked while other threads are in kernels steps its own environments."""
    fish, stop = make_fish(), threading.Event()
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (64, 12))

    def work():
        tank = Tank(fish, 64, water=fish.water, threads=2, lanes="xyz")
        while not stop.is_set():
            tank.swim(action, fish.control_interval)
        tank.close()

    tank = Tank(fish, 64, water=fish.water, threads=2, lanes="xyz")
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


@needs_fork
def test_a_process_forked_while_a_thread_compiles(tmp_path):
    """A process that is forked while another thread compiles can compile too: it inherits no lock that is held."""
    assert run(FORKING, tmp_path).stdout.strip() == "0"


def forked(fish, action, pipe):
    """In a forked process: move fish with threads of its own."""
    tank = Tank(fish, 64, water=fish.water, threads=2, lanes="xyz")
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


@each_way
def test_environments_out_of_an_object_store(task, make):
    """An environment out of an object store, whose arrays are read-only, steps and restarts as the original does."""
    env = make(2, task=task, max_episode_steps=4)
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


# The same bits

LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def digest(threads=1, steps=20, seed=5, **keywords):
    """Digest of all that is observed and rewarded, and of all positions and velocities, over the ends of episodes."""
    env = FishVectorEnv(64, threads=threads, autoreset_mode="SameStep", max_episode_steps=8, **keywords)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (steps, *env.action_space.shape)).astype(np.float32)
    seen = hashlib.sha256(env.reset(seed=seed)[0].tobytes())
    for action in actions:
        for part in (*env.step(action)[:4], env.tank.position, env.tank.velocity):
            seen.update(np.ascontiguousarray(part).tobytes())
    env.close()
    return seen.hexdigest()


def digest_of_process(checkout=ROOT, **variables):
    """Digest that another process finds in a checkout, with three threads for the fish and for the libraries."""
    environment = os.environ | {"PYTHONPATH": f"{checkout}:{ROOT / 'tests'}"} | dict.fromkeys(LIBRARIES, "3")
    command = [sys.executable, "-c", "from test_processes import digest; print(digest(3))"]
    done = subprocess.run(
        command, cwd=checkout, check=True, capture_output=True, text=True, env=environment | variables
    )
    return done.stdout.split()[-1]


def test_threads_and_processes_change_no_bit():
    """One to three threads, and another process whose libraries have three threads of their own, see the same bits."""
    assert digest(1) == digest(2) == digest(3) == digest_of_process()


@pytest.mark.slow
def test_folders_change_no_bit(tmp_path):
    """A clone in another folder, which compiles kernels of its own, simulates to the same bits."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(tmp_path / "clone")], check=True)
    assert digest_of_process(tmp_path / "clone", FISH_ENV_CACHE=str(tmp_path / "kernels")) == digest()


def test_digests_see_what_differs():
    """One step more, another seed, or another option of the task gives another digest."""
    assert len({digest(steps=2), digest(steps=3), digest(steps=2, speed=0.5), digest(steps=2, seed=6)}) == 4


# Memory


class Unmeasured(GlidingVectorEnv):
    """Without kernels, which take no memory."""

    def _compile(self):
        super()._compile()
        self._measure_and_observe = lambda *given: None


def measured(make, few=32, more=160) -> float:
    """Bytes a fish at the most while a tank, or a batch, of a number of fish is made and its state copied."""
    make(8)  # kernels
    peaks = []
    for number in (few, more):
        tracemalloc.start()
        kept = make(number)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        peaks.append(peak)
        del kept
    return (peaks[1] - peaks[0]) / (more - few)


@pytest.mark.parametrize("body", BODIES)
def test_a_tank_takes_what_is_estimated(body):
    """The estimate for a fish of a tank holds what is measured, and is not far above it."""
    fish = make_fish(body)

    def make(count):
        tank = Tank(fish, count, water=fish.water, threads=1, lanes="xyz")
        return tank, tank.get_state()

    assert 0.7 * bytes_of(fish.body) < measured(make) <= bytes_of(fish.body)


@pytest.mark.parametrize(
    ("body", "task"), [(body, "swim") for body in BODIES] + [("mass_spring", task) for task in TASKS if task != "swim"]
)
def test_a_batch_takes_what_is_estimated(body, task):
    """The same of an environment of every body, and of every task."""
    fish = make_fish(body)

    def make(count):
        env = Unmeasured(count, body=fish, task=task, threads=1)
        env.reset(seed=0)
        obs = env.step(np.zeros(env.action_space.shape, np.float32))[0]
        return env, obs, env.tank.get_state()

    estimate = bytes_of(fish.body) + bytes_of_episode(fish)
    assert 0.6 * estimate < measured(make) <= estimate


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("memory.max", "2000000000\n", 2_000_000_000),
        ("memory/memory.limit_in_bytes", "400000000", 400_000_000),
        ("memory.max", "max\n", 16 * 2**30),
        ("memory.max", "999999999999999\n", 16 * 2**30),
        ("other", "1", 16 * 2**30),
    ],
)
def test_limits_of_containers(name, text, wanted, tmp_path, monkeypatch):
    """The limit of a container counts, if it is below the memory of the machine."""
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(text)
    monkeypatch.setattr(checks.os, "sysconf", {"SC_PHYS_PAGES": 2**22, "SC_PAGE_SIZE": 4096}.__getitem__)
    assert checks.available_memory(tmp_path) == wanted


def test_what_does_not_fit_is_named_as_it_was_given(monkeypatch):
    """A batch is refused by the name its user gave, for the container's memory, and the advice fits."""
    monkeypatch.setattr(checks, "available_memory", lambda: 10 * 2**20)
    for make, name in ((lambda count: Tank(make_fish(), count), "num_fish"), (FishVectorEnv, "num_envs")):
        with pytest.raises(ValueError, match=rf"{name} is 10000, which .* has 0.00977 GiB") as error:
            make(10_000)
        make(int(str(error.value).rsplit(" ", 1)[1])).close()


# Arrays that kernels index with


def whole_numbers(value, place, seen):
    """Whole numbers in arrays that public attributes lead to, by where they are."""
    if id(value) in seen:
        return
    seen[id(value)] = value
    parts = {}
    if isinstance(value, np.ndarray) and value.dtype.kind in "iu":
        yield place, value
    elif isinstance(value, dict):
        parts = value
    elif isinstance(value, list | tuple) and not hasattr(value, "_fields"):
        parts = dict(enumerate(value))
    elif type(value).__module__.startswith("fish_env"):
        parts = {name: getattr(value, name, None) for name in dir(value) if not name.startswith("_")}
    for name, part in parts.items():
        if not callable(part):
            yield from whole_numbers(part, f"{place}.{name}", seen)


def env_in_use(id, make, **options):
    """An environment, and how it is used until commands are given."""
    env = make(id, **options).unwrapped
    env.reset(seed=0)

    def use():
        for _ in range(70):
            env.step(np.zeros(env.action_space.shape, np.float32))
        env.call("episode_info") if hasattr(env, "call") else env.episode_info()
        env.reset(seed=0)

    return env, use


def tank_in_use(fish, held=False):
    """A tank, and how it is used."""
    tank = Tank(fish, 2, lanes="xyz")
    if held:
        tank.fix([0, 1])
        tank.grab(2, np.zeros(3), 1.0)

    def use():
        if fish.num_muscles:
            tank.swim(np.zeros(fish.num_muscles), 3 * tank.dt)
        tank.advance(3)
        assert len(tank.failure) == 2
        tank.reset()

    return tank, use


IN_USE = {
    "tank": lambda: tank_in_use(make_fish()),
    "held": lambda: tank_in_use(make_fish(), True),
    "ring": lambda: tank_in_use(OBJECTS["ring"].make()),
    **{f"{task}, one": partial(env_in_use, f"FishEnv/{task}-v0", gym.make) for task in NAMES},
    **{
        f"{task}, batch": partial(env_in_use, f"FishEnv/{task}-v0", gym.make_vec, muscle_groups="pairs", num_envs=2)
        for task in NAMES
    },
}


def attack(name):
    """Write a huge number, and its negative, to each whole number; use the thing; put it back."""
    thing, use = IN_USE[name]()
    for place, array in whole_numbers(thing, name, {}):
        before = array.copy()
        for number in (10**9, -(10**9)):
            try:
                array[...] = number
            except ValueError:  # read-only
                continue
            indices = ("groups", "first_muscle", ".muscles", "node", "drives", "fibres", "left", "right", "landmarks")
            of_env = not isinstance(thing, Tank) and any(each in place for each in indices)
            assert not of_env, f"{place} can be written to"
            with suppress(ValueError, IndexError, OverflowError):
                use()
            array[...] = before


@needs_fork
@pytest.mark.parametrize("name", tiered(IN_USE, ("tank", "Swim, batch")))
def test_huge_numbers_do_no_harm(name):
    """A huge number written to any array that an environment or a tank shows is refused, or ends no process."""
    process = multiprocessing.get_context("fork").Process(target=attack, args=[name])
    process.start()
    process.join(PATIENCE)
    assert process.exitcode == 0


# Trainings that are killed, and that share a folder

KILLED = {"timesteps": 400_000}


def read_run(folder):
    """Read every file of a run that is there; environment steps of its model, 0 without one."""
    from stable_baselines3 import PPO

    if (folder / "config.json").exists():
        assert json.loads((folder / "config.json").read_text())["config"]
    if (folder / "curve.csv").exists():
        assert all(value >= 0.0 for row in read_curve(folder) for name, value in row.items() if name in CURVE[:3])
    if (folder / "policy.npz").exists():
        load_policy(folder / "policy.npz")
    return PPO.load(folder / "model.zip", device="cpu").num_timesteps if (folder / "model.zip").exists() else 0


def saved_since(path, begun):
    """True if a file was written after a time."""
    return path.exists() and path.stat().st_mtime > begun


def alive(process):
    """True until a child process has ended; it is not reaped."""
    return os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


@needs_fork
@pytest.mark.slow
def test_a_run_that_is_killed(tmp_path, monkeypatch):
    """Killed at random times, also while it writes, and resumed: no file is broken, nothing saved is lost; it ends."""
    trainings = pytest.importorskip("trainings")
    from fish_env.training import callbacks

    monkeypatch.setattr(trainings.training, "Checkpoint", lambda *given: callbacks.Checkpoint(*given, seconds=0.0))
    folder, generator, saved = tmp_path / "run", np.random.default_rng(0), 0
    for kill in count():
        request = {"resume": folder} if (folder / "model.zip").exists() else {"folder": folder, "changes": KILLED}
        process = os.fork()
        if not process:
            status = 1
            try:
                trainings.train_short(**{"changes": {}} | request)
                status = 0
            finally:
                os._exit(status)
        begun = time.time()
        while 0 < kill < 8 and not saved_since(folder / "model.zip", begun) and alive(process):
            time.sleep(0.01)
        if kill < 8:
            time.sleep(generator.uniform(0.0, 0.3))
            os.kill(process, signal.SIGKILL)
        ended = os.waitpid(process, 0)[1]
        assert read_run(folder) >= saved
        saved = read_run(folder)
        if ended == 0:
            break
        assert kill < 8
    assert saved >= KILLED["timesteps"] and json.loads((folder / "config.json").read_text())["resumed"] >= 1


# Interrupted steps

FISH, STEPS, QUICK = 64, 3, "mass_spring"
INTERRUPTIONS = 17
"""For each body and number of threads: 204 in all."""


class Interruption(BaseException):
    """What a signal raises here."""


@pytest.fixture
def alarm():
    """A function that has `Interruption` raised in the main thread after some seconds."""

    def ring(number, frame):
        raise Interruption

    before = signal.signal(signal.SIGALRM, ring)
    yield lambda seconds: signal.setitimer(signal.ITIMER_REAL, seconds)
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def bits(env, begin) -> list[bytes]:
    """All that a batch shows and keeps in some steps after a beginning."""
    rng, found = np.random.default_rng(3), [begin(env)]
    for _ in range(STEPS):
        obs, reward, *_ = env.step(rng.uniform(-1.0, 1.0, env.action_space.shape))
        found += [obs, reward, *env.tank.get_state().values()]
    return [np.asarray(array).tobytes() for array in found]


def interrupted(env, ring, alarm, longest):
    """Step and reset until the interruption comes."""
    action = np.zeros(env.action_space.shape)
    while True:
        try:
            alarm(ring.uniform(1e-5, longest))
            for k in range(10_000):
                env.step(action)
                if k % 5 == 4:
                    env.reset(seed=k)
        except Interruption:
            return


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("body", [pytest.param(b, marks=[] if b == QUICK else pytest.mark.slow) for b in BODIES])
def test_nothing_is_left_of_an_interrupted_step(body, threads, alarm):
    """After `reset(seed)`, or `set_state` of the tank, a batch goes on with the bits of a fresh one."""
    options = {"task": "swim", "body": body, "threads": threads, "variation": {"stiffness": (0.8, 1.25)}}
    fresh, env, ring = FishVectorEnv(FISH, **options), FishVectorEnv(FISH, **options), np.random.default_rng(threads)
    wanted = bits(fresh, lambda env: env.reset(seed=0)[0])
    begun = time.perf_counter()
    bits(env, lambda env: env.reset(seed=1)[0])
    longest = time.perf_counter() - begun
    fresh.reset(seed=5)
    state = fresh.tank.get_state()
    after_state = after(fresh, state)
    for k in range(INTERRUPTIONS):
        env.reset(seed=k)
        interrupted(env, ring, alarm, longest)
        if k % 2:
            assert after(env, state) == after_state, f"interruption {k}"
        assert bits(env, lambda env: env.reset(seed=0)[0]) == wanted, f"interruption {k}"


def after(env, state) -> list[bytes]:
    """The fish of a tank a few intervals after a state, without the environment around them."""
    env.tank.set_state(state)
    for k in range(STEPS):
        env.tank.swim(np.full(12, 0.2 * k), env.control_interval)
    return [array.tobytes() for array in env.tank.get_state().values()]


def test_nothing_works_on(alarm):
    """`Threads.run` raises an error or an interruption when all jobs have ended, in whichever thread it came."""
    for threads in (1, 2, 4):
        pool, ended = Threads(threads), []

        def work(number, fails, ended=ended):
            time.sleep(0.05)
            ended.append(number)
            if fails:
                raise ValueError("a mistake")

        alarm(0.02)
        with pytest.raises(Interruption):
            pool.run(work, [(k, False) for k in range(threads)])
        assert sorted(ended) == list(range(threads))
        with pytest.raises(ValueError, match="a mistake"):
            pool.run(work, [(k, k == 0) for k in range(threads)])
        assert len(ended) == 2 * threads
        before = threading.active_count()
        pool.close()
        while threading.active_count() > before - threads:  # they end by themselves
            time.sleep(0.001)
        pool.run(work, [(0, False)])
        pool.close()


def test_signals_wait_while_kernels_are_compiled(alarm):
    """A kernel whose compilation a signal comes into is compiled to its end, and usable after the exception."""
    for k in range(5):

        @kernel
        def inner(x, k=float(k)):
            return x * k + np.sqrt(x)

        @njit
        def call(x, inner=inner):
            return inner(x) + inner(x * 2.0)

        alarm(0.005 * (k + 1))
        with pytest.raises(Interruption):
            call(4.0)
            time.sleep(10.0)
        assert call(4.0) == 12.0 * k + 2.0 + np.sqrt(8.0) and len(call.signatures) == 1


def test_signals_are_held_in_the_main_thread_alone(alarm):
    """A held signal is handled at the end, once, whatever happens in between; another thread leaves all as it is."""
    with pytest.raises(Interruption), defer_signals():
        signal.raise_signal(signal.SIGALRM)
        reached = True
    assert reached
    with pytest.raises(Interruption), defer_signals():
        signal.raise_signal(signal.SIGALRM)
        raise ValueError("replaced")
    handler, seen = signal.getsignal(signal.SIGALRM), []

    def elsewhere():
        with defer_signals():
            seen.append(signal.getsignal(signal.SIGALRM))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert seen == [handler] and signal.getsignal(signal.SIGALRM) is handler
