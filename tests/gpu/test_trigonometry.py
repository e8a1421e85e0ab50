"""Sines of a device, whose own may be wrong in the fourth digit."""

import numpy as np
import pytest
from taichi_sim.kernels.contacts.contact_law import largest_eigenvalue
from taichi_sim.kernels.trigonometry import arccosine, cosine, sine, sine_cosine

from taichi_sim.device.engine import ti

pytestmark = pytest.mark.gpu

N = 4001


@ti.kernel
def work_out(a: ti.template(), found: ti.template()):
    for i in a:
        s, c = sine_cosine(a[i])
        inverse = arccosine(ti.max(-1.0, ti.min(1.0, a[i])))
        found[i] = ti.Vector([s, c, sine(a[i]), cosine(a[i]), inverse])


@ti.kernel
def largest(T: ti.template(), found: ti.template()):
    for i in T:
        found[i] = largest_eigenvalue(T[i])


@pytest.mark.parametrize("top", [1e-3, 0.1, 1.0, 3.2, 1000.0])  # rad: from what a collider turns in a step on
def test_to_the_last_digits(top):
    angle = np.linspace(-top, top, N).astype(np.float32)
    a, found = ti.field(ti.f32, N), ti.Vector.field(5, ti.f32, N)
    a.from_numpy(angle)
    work_out(a, found)
    exact = angle.astype(float)
    s, c = np.sin(exact), np.cos(exact)
    expected = np.stack([s, c, s, c, np.arccos(np.clip(exact, -1, 1))], axis=1)
    np.testing.assert_allclose(found.to_numpy(), expected, rtol=0, atol=5e-7)


def test_the_split_of_a_ball_between_its_contacts():
    """The largest eigenvalue of sums of n n^T; nothing twice, where single precision has half of its digits."""
    normal = np.random.default_rng(0).normal(size=(500, 5, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    T, found = ti.Matrix.field(3, 3, ti.f32, len(normal)), ti.field(ti.f32, len(normal))
    sums = np.einsum("kci,kcj->kij", normal, normal).astype(np.float32)
    T.from_numpy(sums)
    largest(T, found)
    np.testing.assert_allclose(found.to_numpy(), np.linalg.eigvalsh(sums.astype(float))[:, -1], rtol=2e-5)
