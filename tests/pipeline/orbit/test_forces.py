"""Forces and their gradients against formulas of the tests, differentiated by complex steps."""

import numpy as np
import pytest
from relative import STEP, pull

from pipeline.orbit.forces import (
    atmosphere_near,
    drag,
    drag_gradient,
    gravity_gradient,
    oblateness,
    point_mass,
)

RNG = np.random.default_rng(0)

STATES = RNG.normal(size=(20, 6)) * np.repeat([5e6, 5e3], 3) + np.array([4e6, 0, 0, 0, 4e3, 0])


def gradient(states, **forces):
    steps = states[:, None] + 1j * STEP * np.eye(6)
    return pull(steps, **forces).imag.swapaxes(1, 2) / STEP


@pytest.mark.parametrize("j2", [False, True])
def test_gravity_and_its_gradient(j2):
    position = STATES[:, :3]
    given = point_mass(position) + (oblateness(position) if j2 else 0.0)
    np.testing.assert_allclose(given, pull(STATES, j2), rtol=1e-12, atol=1e-15)
    truth = gradient(STATES, j2=j2)
    found = gravity_gradient(position, j2=j2)
    size = np.abs(truth).max(axis=(1, 2), keepdims=True)
    assert (np.abs(found - truth[..., :3]) < 1e-13 * size).all()
    np.testing.assert_allclose(np.trace(found, axis1=1, axis2=2) / size[:, 0, 0], 0, atol=1e-13)


def test_drag_and_its_gradient():
    """Also of one state, and of air far above its layer, where none is left."""
    air = atmosphere_near(400e3)
    place = STATES[:, :3] / np.linalg.norm(STATES[:, :3], axis=1)[:, None]
    height = np.concatenate([RNG.uniform(300e3, 700e3, 19), [1e8]])
    states = np.concatenate([place * (6378137.0 + height)[:, None], STATES[:, 3:]], axis=1)
    layer = air.base, air.density, air.scale

    forces = {"j2": False, "ballistic": 0.5, "air": layer}
    found = drag(states, np.full(20, 0.5), air)
    np.testing.assert_allclose(found, pull(states, **forces) - pull(states, False), atol=1e-14)
    np.testing.assert_allclose(drag(states[0], np.array(0.5), air), found[0], rtol=1e-14)
    truth = gradient(states, **forces) - gradient(states, j2=False)
    found = drag_gradient(states, 0.5, air)
    for part in (slice(0, 3), slice(3, 6)):
        size = np.abs(truth[:19, :, part]).max(axis=(1, 2), keepdims=True)
        assert (np.abs(found - truth)[:19, :, part] < 1e-8 * size).all()
    np.testing.assert_allclose(found[19], 0.0, atol=1e-300)
