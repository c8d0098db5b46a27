"""The rival of `collapsed_evidence.py`: an extended Kalman filter in jax.

Run by that script in an environment of its own, with the name of a file of positions
`(flock, time, individual, 2)`. Evaluates the evidence with gradient once for each line that it
reads, and writes seconds, evidence and gradient.
"""

import json
import sys
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

DT, RADIUS, SPEED = 0.1, 2.0, 1.0


def step_mean(parameters, state):
    """Return the next state `(individual * 4)` without noise."""
    kc, ks, ka, kd = parameters[:4]
    z = state.reshape(-1, 4)
    p, v = z[:, :2], z[:, 2:]
    offset = p[None] - p[:, None]
    squared = (offset**2).sum(-1)
    eye = jnp.eye(len(p))
    near = jnp.where((squared <= RADIUS**2) & (eye == 0), 1.0, 0.0)
    count = near.sum(-1, keepdims=True)
    some = jnp.where(count > 0, 1.0 / jnp.maximum(count, 1.0), 0.0)
    cohesion = (near @ p) * some - p * (count > 0)
    alignment = (near @ v) * some - v * (count > 0)
    safe = squared + eye
    separation = -(near / safe)[..., None] * offset
    speed = (v**2).sum(-1, keepdims=True)
    ratio = jnp.where(speed > 0, SPEED / jnp.sqrt(jnp.where(speed > 0, speed, 1.0)) - 1.0, 0.0)
    force = kc * cohesion + ks * separation.sum(1) + ka * alignment + kd * ratio * v
    moved = v + DT * force
    return jnp.concatenate([p + DT * moved, moved], -1).reshape(-1)


def evidence_of(parameters, positions, mean, covariance):
    """Return the evidence of one flock `(time, individual, 2)`."""
    number = positions.shape[1]
    process, tracking = parameters[4], parameters[5]
    pick = np.kron(np.eye(number), np.eye(2, 4))
    lift = np.kron(np.eye(number), np.concatenate([DT * np.eye(2), np.eye(2)]))
    noise = process**2 * DT * (lift @ lift.T)
    blur = tracking**2 * jnp.eye(2 * number)

    def update(mean, covariance, seen):
        cross = pick @ covariance
        factor = jnp.linalg.cholesky(cross @ pick.T + blur)
        white = jax.scipy.linalg.solve_triangular(factor, cross, lower=True)
        e = jax.scipy.linalg.solve_triangular(factor, seen - pick @ mean, lower=True)
        value = -0.5 * e @ e - jnp.log(jnp.diag(factor)).sum() - number * jnp.log(2 * jnp.pi)
        return mean + white.T @ e, covariance - white.T @ white, value

    def step(carry, seen):
        mean, covariance = carry
        jacobian = jax.jacfwd(step_mean, argnums=1)(parameters, mean)
        mean = step_mean(parameters, mean)
        covariance = jacobian @ covariance @ jacobian.T + noise
        mean, covariance, value = update(mean, covariance, seen)
        return (mean, covariance), value

    rows = positions.reshape(len(positions), -1)
    mean, covariance, first = update(mean, covariance, rows[0])
    _, values = jax.lax.scan(step, (mean, covariance), rows[1:])
    return first + values.sum()


def main() -> None:
    """Answer each line with the evidence and its gradient."""
    given = np.load(sys.argv[1])
    positions = jnp.asarray(given["positions"])
    number = positions.shape[2]
    mean = jnp.tile(jnp.asarray(given["initial_mean"]), number)
    covariance = jnp.diag(jnp.tile(jnp.asarray(given["initial_scale"]) ** 2, number))
    parameters = jnp.asarray(given["parameters"])

    @jax.jit
    def score(parameters):
        total = jax.vmap(evidence_of, (None, 0, None, None))
        return jax.value_and_grad(lambda p: total(p, positions, mean, covariance).sum())(parameters)

    jax.block_until_ready(score(parameters))
    print("ready", jax.__version__, flush=True)
    for _ in sys.stdin:
        began = time.perf_counter()
        value, gradient = jax.block_until_ready(score(parameters))
        seconds = time.perf_counter() - began
        row = {"seconds": seconds, "value": float(value), "gradient": np.asarray(gradient).tolist()}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
