"""Interrupted steps: Ctrl-C or an alarm leaves nothing behind that a reset or a state does not replace."""

import signal
import threading
import time

import numpy as np
import pytest

from fish_env import BODIES
from fish_env.envs import FishVectorEnv
from fish_env.kernels.compile import kernel, njit
from fish_env.kernels.threads import Threads, defer_signals

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
    for count in (1, 2, 4):
        pool, ended = Threads(count), []

        def work(number, fails, ended=ended):
            time.sleep(0.05)
            ended.append(number)
            if fails:
                raise ValueError("a mistake")

        alarm(0.02)
        with pytest.raises(Interruption):
            pool.run(work, [(k, False) for k in range(count)])
        assert sorted(ended) == list(range(count))
        with pytest.raises(ValueError, match="a mistake"):
            pool.run(work, [(k, k == 0) for k in range(count)])
        assert len(ended) == 2 * count
        before = threading.active_count()
        pool.close()
        while threading.active_count() > before - count:  # they end by themselves
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
