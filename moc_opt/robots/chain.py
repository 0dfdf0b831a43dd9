"""The serial chain as plain numbers and as CasADi functions."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import Array

if TYPE_CHECKING:
    import casadi


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain. Each joint is placed in the previous joint's frame, the first one in the world frame."""

    rotations: Array  #: (n,3,3)
    origins: Array  #: (n,3) [m]
    axes: Array  #: (n,3) unit vectors in the joints' own frames
    prismatic: NDArray[np.bool_]  #: (n,)
    offsets: Array  #: (2,3) tip and wrist in the last joint's frame [m]

    @property
    def joints(self) -> Array:
        """The chain (n,16) for the core: rotation, origin, axis, and 1 for a prismatic joint, else 0."""
        parts = (self.rotations.reshape(-1, 9), self.origins, self.axes, self.prismatic[:, None])
        return np.hstack(parts).astype(np.float64)


def desired_wrist(
    tip: ArrayLike, tip_velocity: ArrayLike, trocar: ArrayLike, trocar_velocity: ArrayLike, span: float
) -> tuple[Array, Array]:
    """Compute the desired wrist N_d = X + L e [m] and its velocity [m/s], (..., 3) each.

    X is the tip, P_t the trocar, e = (P_t - X)/|P_t - X|, and L the ``span`` [m].
    """
    line, turn = np.subtract(trocar, tip), np.subtract(trocar_velocity, tip_velocity)
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    e = line / distance
    turn = (turn - (e * turn).sum(-1, keepdims=True) * e) / distance
    return np.add(tip, span * e), np.add(tip_velocity, span * turn)


@dataclass(frozen=True)
class Kinematics:
    """CasADi functions of q (n,). mu has no gradient at a singularity."""

    id: str  #: Robot name and a hash of the chain.
    n: int
    tip: casadi.Function = field(compare=False, repr=False)  #: Tip (3,) [m].
    wrist: casadi.Function = field(compare=False, repr=False)  #: Wrist (3,) [m].
    mu: casadi.Function = field(compare=False, repr=False)  #: Manipulability.
    grad_mu: casadi.Function = field(compare=False, repr=False)  #: Gradient of mu (n,).
    shaft: casadi.Function = field(compare=False, repr=False)
    """(mu_shaft / |tip - wrist|^2)^2, smooth even at 0. mu_shaft: manipulability of the shaft while the tip rests."""


@lru_cache(maxsize=64)
def build_kinematics(name: str, chain: Chain) -> Kinematics:
    """Write the chain's kinematics in CasADi."""
    import casadi as ca  # a slow import

    q = ca.SX.sym("q", len(chain.axes))
    rotation, origin = ca.SX.eye(3), ca.SX.zeros(3)
    joints: list[tuple[Any, Any]] = []  # world axis, world origin
    for j in range(len(chain.axes)):
        origin = origin + ca.mtimes(rotation, ca.DM(chain.origins[j]))
        rotation = ca.mtimes(rotation, ca.DM(chain.rotations[j]))
        axis = ca.DM(chain.axes[j])
        if chain.prismatic[j]:
            origin = origin + ca.mtimes(rotation, axis) * q[j]
        else:
            k = ca.skew(axis)  # Rodrigues' formula
            rotation = ca.mtimes(rotation, ca.SX.eye(3) + ca.sin(q[j]) * k + (1 - ca.cos(q[j])) * ca.mtimes(k, k))
        joints.append((ca.mtimes(rotation, axis), origin))
    tip, wrist = (origin + ca.mtimes(rotation, ca.DM(offset)) for offset in chain.offsets)
    jacobian, lever = (
        ca.horzcat(*(
            axis if slides else ca.cross(axis, point - at)
            for (axis, at), slides in zip(joints, chain.prismatic, strict=True)
        ))
        for point in (tip, wrist)
    )  # fmt: skip
    gram = ca.mtimes(jacobian, jacobian.T)
    mu = ca.sqrt(ca.det(gram))
    held = ca.mtimes([lever, jacobian.T, ca.inv_minor(gram)])
    schur = ca.mtimes(lever, lever.T) - ca.mtimes([held, jacobian, lever.T])
    minors = sum(schur[a, a] * schur[b, b] - schur[a, b] * schur[b, a] for a, b in ((0, 1), (1, 2), (2, 0)))
    shaft = minors / float(np.linalg.norm(chain.offsets[0] - chain.offsets[1])) ** 4
    outputs = {"tip": tip, "wrist": wrist, "mu": mu, "grad_mu": ca.gradient(mu, q), "shaft": shaft}
    functions = {key: ca.Function(key, [q], [value], ["q"], [key]) for key, value in outputs.items()}
    geometry = hashlib.sha256(chain.joints.tobytes() + chain.offsets.tobytes()).hexdigest()[:12]
    return Kinematics(id=f"{name}-{geometry}", n=len(chain.axes), **functions)
