"""Actor and critic of a policy, and PPO's loss, forward and backward, as compiled kernels.

Samples are processed in blocks so small that the output of their layers stays in the nearest cache of the processor.
Products are BLAS's (`numpy.dot`); the rest is plain loops over contiguous numbers, which the compiler vectorises.

Legend: n samples; D numbers of an observation; I images of it: an equivariant policy takes it as it is and reflected;
R = n I rows, the images of a sample behind one another; A actions; V, W inputs and outputs of a layer.
"""

import math
from typing import NamedTuple

import numpy as np
from numba.core import types
from numba.extending import overload

from fish_env.kernels.compile import njit, part

BLOCK = 64  # samples
HALF_LOG_TWO_PI = 0.5 * math.log(2 * math.pi)


class Network(NamedTuple):
    """Layers of an actor or a critic, with tanh between them; or numbers of the same shapes."""

    weights: tuple[np.ndarray, ...]
    """(W,V) of every layer."""
    biases: tuple[np.ndarray, ...]
    """(W,)"""


class Images(NamedTuple):
    """Maps of a policy's observations and actions; image m of an observation is (obs[place] - offset) * factor."""

    place: np.ndarray
    """(I,D) indices of numbers."""
    offset: np.ndarray
    """(I,D)"""
    factor: np.ndarray
    """(I,D) sign over scale."""
    swap: np.ndarray
    """(I,A) which output for each image an action is the mean of."""


class Policy(NamedTuple):
    """Parameters of actor and critic, or the gradient with respect to them."""

    log_std: np.ndarray
    """(A,) logarithms of the standard deviations."""
    actor: Network
    """Its last layer has A outputs."""
    critic: Network
    """Its last layer has one."""


class Work(NamedTuple):
    """Work arrays of a network for one block of rows."""

    given: tuple[np.ndarray, ...]
    """(R,W) outputs of every layer."""
    slopes: tuple[np.ndarray, ...]
    """(R,W) the gradient with respect to that, before tanh."""
    products: tuple[np.ndarray, ...]
    """(W,V) a block's part of the gradient with respect to the weights."""


class Samples(NamedTuple):
    """A rollout of N samples."""

    seen: np.ndarray
    """(N,I,D)"""
    actions: np.ndarray
    """(N,A)"""
    log_probs: np.ndarray
    """(N,) of the actions when they were drawn."""
    values: np.ndarray
    """(N,) by the critic then."""
    advantages: np.ndarray
    """(N,)"""
    returns: np.ndarray
    """(N,)"""


class Settings(NamedTuple):
    """Settings of the loss of a minibatch."""

    mean: float
    """Subtracted from the advantages."""
    spread: float
    """Divisor of the advantages."""
    clip: float
    """Largest distance of the ratio from 1."""
    value_clip: float
    """Largest distance of a value from the previous one; infinite for no limit."""
    value_weight: float
    """Weight of the value loss."""


def tanh(x):
    """The hyperbolic tangent: libm's in double precision, a rational function to 3e-7 in single precision."""
    return np.tanh(x)


@overload(tanh)
def _tanh(x):
    return _tanh32 if x == types.float32 else lambda x: math.tanh(x)


def _tanh32(x):
    """The rational function of Eigen (`generic_fast_tanh_float`), odd of degree 13 over even of degree 6."""
    f = np.float32
    x = f(7.9) if x > f(7.9) else x  # there it is 1 to rounding; not min, which would hide a NaN
    x = f(-7.9) if x < f(-7.9) else x
    q = x * x
    p = f(-2.76076847742355e-16) * q + f(2.00018790482477e-13)
    p = p * q + f(-8.60467152213735e-11)
    p = p * q + f(5.12229709037114e-08)
    p = p * q + f(1.48572235717979e-05)
    p = p * q + f(6.37261928875436e-04)
    p = p * q + f(4.89352455891786e-03)
    r = f(1.19825839466702e-06) * q + f(1.18534705686654e-04)
    r = r * q + f(2.26843463243900e-03)
    r = r * q + f(4.89352518554385e-03)
    return x * p / r


@njit
def see(obs, images, seen):
    """All images (n,I,D) of observations (n,D)."""
    place, offset, factor = images.place, images.offset, images.factor
    for i in range(obs.shape[0]):
        for m in range(place.shape[0]):
            for d in range(place.shape[1]):
                seen[i, m, d] = (obs[i, place[m, d]] - offset[m, d]) * factor[m, d]


@njit
def forward(seen, weights, biases, given):
    """Compute the outputs of every layer for rows (R,D).

    The weights (V,W) are transposed: BLAS takes a third less time for them.
    """
    below, last = seen, len(given) - 1
    for k in range(len(given)):
        out, bias = given[k][: seen.shape[0]], biases[k]
        np.dot(below, weights[k], out)
        for i in range(out.shape[0]):
            if k < last:
                for j in range(bias.size):
                    out[i, j] = tanh(out[i, j] + bias[j])
            else:
                for j in range(bias.size):
                    out[i, j] += bias[j]
        below = out


@njit
def backward(seen, network, work, total):
    """Add to the gradient with respect to a network what rows (R,D) contribute; work.slopes[-1] is its beginning."""
    rows = seen.shape[0]
    for back in range(len(work.given)):
        k = len(work.given) - 1 - back
        slope, below = work.slopes[k][:rows], seen if k == 0 else work.given[k - 1][:rows]
        product, weight, bias = work.products[k], total.weights[k], total.biases[k]
        np.dot(slope.T, below, product)
        for j in range(weight.shape[0]):
            for d in range(weight.shape[1]):
                weight[j, d] += product[j, d]
        for i in range(rows):
            for j in range(bias.size):
                bias[j] += slope[i, j]
        if k > 0:
            under, one = work.slopes[k - 1][:rows], below.dtype.type(1)
            np.dot(slope, network.weights[k], under)
            for i in range(rows):
                for j in range(under.shape[1]):
                    under[i, j] *= one - below[i, j] * below[i, j]


@part
def decide(given, swap, mean):
    """Mean actions (n,A) of samples, from the outputs of the last layer for their images."""
    images = swap.shape[0]
    for i in range(mean.shape[0]):
        for a in range(mean.shape[1]):
            total = given[i * images, swap[0, a]]
            for m in range(1, images):
                total += given[i * images + m, swap[m, a]]
            mean[i, a] = total / images


@part
def judge(given, images, value):
    """Values (n,) of samples."""
    for i in range(value.size):
        total = given[i * images, 0]
        for m in range(1, images):
            total += given[i * images + m, 0]
        value[i] = total / images


@part
def loss(samples, which, settings, log_std, mean, value, sums):
    """PPO's loss of samples (Schulman et al. 2017, as Stable-Baselines3 has it), and its slopes.

    Args:
        samples: the rollout.
        which: (n,) indices of samples.
        settings: of the minibatch.
        log_std: (A,)
        mean: (n,A) mean actions now; out: the slopes with respect to them.
        value: (n,) values now; out: the slopes with respect to them.
        sums: (A,) the slope with respect to `log_std`, and (4,) the policy's loss, the value's, clipped ratios, and an
            estimate of the Kullback-Leibler divergence from the policy before; added to. (A,) to work in.
    """
    action, before, near, inverse, constant = samples.actions, samples.log_probs, settings.value_clip, sums[2], 0.0
    for a in range(log_std.size):
        inverse[a] = math.exp(-log_std[a])
        constant -= log_std[a] + HALF_LOG_TWO_PI
    for i in range(which.size):
        b, log_prob = which[i], constant
        for a in range(inverse.size):
            z = (action[b, a] - mean[i, a]) * inverse[a]
            log_prob -= z * z / 2
        log_ratio = log_prob - before[b]
        ratio, advantage = math.exp(log_ratio), (samples.advantages[b] - settings.mean) / settings.spread
        gain, limited = advantage * ratio, advantage * min(max(ratio, 1.0 - settings.clip), 1.0 + settings.clip)
        slope = -gain if gain <= limited else 0.0
        for a in range(inverse.size):
            z = (action[b, a] - mean[i, a]) * inverse[a]
            mean[i, a] = slope * z * inverse[a]
            sums[0][a] += slope * (z * z - 1.0)
        change = value[i] - samples.values[b]
        error = samples.values[b] + min(max(change, -near), near) - samples.returns[b]
        value[i] = 2.0 * settings.value_weight * error if abs(change) <= near else 0.0
        sums[1][0] -= min(gain, limited)
        sums[1][1] += error * error
        sums[1][2] += abs(ratio - 1.0) > settings.clip
        sums[1][3] += ratio - 1.0 - log_ratio


@part
def part_slopes(mean, value, swap, actor, critic):
    """Distribute the slopes of samples over the outputs of the last layers for their images."""
    images = swap.shape[0]
    for i in range(mean.shape[0]):
        for m in range(images):
            critic[i * images + m, 0] = value[i] / images
            for a in range(mean.shape[1]):
                actor[i * images + m, swap[m, a]] = mean[i, a] / images


@njit
def gather(seen, which, rows):
    """All images of some samples, one behind the other."""
    images = seen.shape[1]
    for i in range(which.size):
        b = which[i]
        for m in range(images):
            for d in range(seen.shape[2]):
                rows[i * images + m, d] = seen[b, m, d]


@njit
def differentiate(samples, which, settings, policy, transposed, swap, work, sums):
    """Add up the gradient of the losses of samples.

    Args:
        samples: the rollout.
        which: (n,) indices of samples.
        settings: of the minibatch.
        policy: as it is now.
        transposed: weights (V,W) of actor and critic.
        swap: (I,A) as in `Images`.
        work: rows (R,D) for a block, and work of actor and critic.
        sums: the gradient with respect to the policy, and what is logged (4,), added to (`loss`).
    """
    (images, actions), (total, statistics), (seen, actor, critic) = swap.shape, sums, work
    means, values, inverse = np.empty((BLOCK, actions), seen.dtype), np.empty(BLOCK, seen.dtype), np.empty(actions)
    for low in range(0, which.size, BLOCK):
        here = which[low : low + BLOCK]
        rows, mean, value = seen[: here.size * images], means[: here.size], values[: here.size]
        gather(samples.seen, here, rows)
        forward(rows, transposed[0], policy.actor.biases, actor.given)
        forward(rows, transposed[1], policy.critic.biases, critic.given)
        decide(actor.given[-1], swap, mean)
        judge(critic.given[-1], images, value)
        loss(samples, here, settings, policy.log_std, mean, value, (total.log_std, statistics, inverse))
        part_slopes(mean, value, swap, actor.slopes[-1], critic.slopes[-1])
        backward(rows, policy.actor, actor, total.actor)
        backward(rows, policy.critic, critic, total.critic)
