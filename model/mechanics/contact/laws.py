"""Scalar laws of contact, slip, damping and bond strength: one formula each.

Forces are per unit depth. The normal n of a contact points from grain a to grain b, the
tangent t is n turned by +90°. The force on b is F_n n + F_s t, on a its opposite; F_n is
positive in compression. Source, where no other is named: Potyondy & Cundall (2004), A
bonded-particle model for rock, Int. J. Rock Mech. Min. Sci. 41, 1329–1364.
"""

from __future__ import annotations

from demflow.model.compile import kernel


@kernel
def normal_force(kn: float, un: float) -> float:
    """Normal force of an overlap U_n: F_n = k_n U_n."""
    return kn * un


@kernel
def shear_force(fs: float, ks: float, dus: float) -> float:
    """Shear force after b moved by ΔU_s past a along t: F_s ← F_s − k_s ΔU_s.

    Parameters
    ----------
    fs : shear force before
    ks : shear stiffness k_s
    dus : ΔU_s of b past a along t
    """
    return fs - ks * dus


@kernel
def tangential_step(
    ux: float,
    uy: float,
    nx: float,
    ny: float,
    inverse_distance: float,
    turn_a: float,
    turn_b: float,
    arm_a: float,
    arm_b: float,
) -> float:
    """Tangential displacement ΔU_s of b past a at their contact in one step.

    (ux, uy) is the step of b's centre relative to a's; normal, distance and arms are those
    after it, turns the rotations during it. ΔU_s = Δu·t − θ_a l_a − θ_b l_b is taken at the
    middle of the step, where the distance was smaller by h = Δu·n / 2 and each arm by h / 2;
    at its end it would be of first order.

    Parameters
    ----------
    ux : step of b’s centre relative to a’s, along x
    uy : the same along y
    nx : normal from a to b, after the step
    ny : the same along y
    inverse_distance : one over the distance of the centres, after the step
    turn_a : rotation θ_a of a during the step
    turn_b : rotation θ_b of b
    arm_a : lever l_a from a to the contact, after the step
    arm_b : lever l_b
    """
    h = 0.5 * (ux * nx + uy * ny)
    along = (uy * nx - ux * ny) * (1.0 + h * inverse_distance)
    return along - turn_a * (arm_a - 0.5 * h) - turn_b * (arm_b - 0.5 * h)


@kernel
def slip(fs: float, limit: float) -> float:
    """Shear force that friction can hold: |F_s| ≤ limit = μ F_n (Coulomb)."""
    if fs > limit:
        return limit
    if fs < -limit:
        return -limit
    return fs


@kernel
def local_damping(force: float, velocity: float, alpha: float) -> float:
    """Force left after local damping: F − α |F| sign(v) (Cundall 1987).

    What stands still counts as moving against the force, F (1 + α), so that no sign of zero is
    asked for in the loop over grains; it lasts for one step.

    Parameters
    ----------
    force : F
    velocity : v, of which the sign counts
    alpha : α, in [0, 1)
    """
    if force * velocity > 0.0:
        return force * (1.0 - alpha)
    return force * (1.0 + alpha)


@kernel
def bond_tension(fn: float, moment: float, half_width: float) -> float:
    """Largest tensile stress in a bond: −F_n / A + |M| R̄ / I, with A = 2 R̄, I = 2 R̄³ / 3.

    Parameters
    ----------
    fn : normal force, compression positive
    moment : bending moment M
    half_width : R̄ of the bond
    """
    return -fn / (2.0 * half_width) + 1.5 * abs(moment) / (half_width * half_width)


@kernel
def bond_shear(fs: float, half_width: float) -> float:
    """Mean shear stress in a bond: |F_s| / A, with A = 2 R̄."""
    return abs(fs) / (2.0 * half_width)


@kernel
def bond_shear_strength(cohesion: float, friction: float, fn: float, half_width: float) -> float:
    """Shear stress that cement holds: τ_c = c + μ̄ max(F_n, 0) / A (Mohr–Coulomb).

    Without friction, μ̄ = 0, it is the shear strength of Potyondy & Cundall (2004).

    Parameters
    ----------
    cohesion : c, Pa
    friction : μ̄
    fn : normal force, compression positive
    half_width : R̄ of the bond
    """
    return cohesion + friction * max(fn, 0.0) / (2.0 * half_width)


@kernel
def spent(before: float, after: float, stiffness: float, stretch: float) -> float:
    """Energy that a spring loses where it slips or breaks during a step.

    What was stored, less what is, plus the work put in: (F₀² − F₁²) / 2k − (F₀ + F₁) Δu / 2
    with F₁ = F₀ − k Δu for a spring that holds, which loses nothing.

    Parameters
    ----------
    before : force F₀ before the step
    after : force F₁ after it
    stiffness : k
    stretch : Δu of the step
    """
    if stiffness == 0.0:
        return 0.0
    return 0.5 * (before + after) * ((before - after) / stiffness - stretch)
