"""Basilisk's formation reconfiguration, run by Basilisk itself (its example of that name).

A deputy changes its orbital-element differences from a chief by three burns within one orbit, at
apogee, at perigee and across the plane, and its attitude control turns it to each.
"""

from typing import Any

import numpy as np

from benchmarks.peers import required_module
from pipeline.arrays import Array, Float

PACKAGE = "bsk==2.12.1"
CHIEF = np.array([11e6, 0.4, *np.radians([60.0, 90.0, 60.0, 40.0])])  # a, e, i, Ω, ω, M
BEGIN = np.array([3e-4 * CHIEF[0], -2e-4, 1e-4, 4e-4, -1e-4, 2e-4])  # differences at the start
TARGET = [0.0, 1e-4, 2e-4, -1e-4, -2e-4, -3e-4]  # wanted; the first as a share of a
MASS, INERTIA = 500.0, (900.0, 0.0, 0.0, 0.0, 800.0, 0.0, 0.0, 0.0, 600.0)
STEP, ORBITS = 2.0, 1.1  # of the integration, s; time simulated, in the deputy's first periods


def reconfiguration() -> tuple[float, Float[Array, "6"]]:
    """Δv that the deputy spends, m/s, and by how much it misses its target's differences."""
    macros, orbits = _module("utilities.macros"), _module("utilities.orbitalMotion")
    sim, step = _module("utilities.SimulationBaseClass").SimBaseClass(), macros.sec2nano(STEP)
    sim.CreateNewProcess("all").addTask(sim.CreateNewTask("all", step))
    chief, deputy, mu = _craft(sim)
    thrusters, torque, config = _actuators(sim, deputy)
    _guidance(sim, chief, deputy, thrusters, torque, config)
    for craft, elements in ((chief, CHIEF), (deputy, CHIEF + BEGIN)):
        given = orbits.ClassicElements()
        given.a, given.e, given.i, given.Omega, given.omega, M = elements
        given.f = orbits.E2f(orbits.M2E(M, given.e), given.e)
        craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = orbits.elem2rv(mu, given)
    logs = [craft.scStateOutMsg.recorder(step) for craft in (chief, deputy)]
    for log in logs:
        sim.AddModelToTask("all", log)
    sim.InitializeSimulation()
    period = 2 * np.pi * np.sqrt((CHIEF + BEGIN)[0] ** 3 / mu)
    sim.ConfigureStopTime(macros.sec2nano(ORBITS * period))
    sim.ExecuteSimulation()
    spent = np.linalg.norm(np.diff(logs[1].TotalAccumDV_CN_N, axis=0), axis=1).sum()
    first, second = (_elements(orbits, mu, log.r_BN_N[-1], log.v_BN_N[-1]) for log in logs)
    found = second - first
    found[0] /= first[0]
    return float(spent), found - TARGET


def _module(name: str) -> Any:
    """A module of Basilisk; InputError where that is not installed."""
    return required_module(f"Basilisk.{name}", PACKAGE)


def _craft(sim: Any) -> tuple[Any, Any, float]:
    """Chief and deputy about a spherical Earth, and its μ, m³/s²."""
    gravity = _module("utilities.simIncludeGravBody").gravBodyFactory()
    earth = gravity.createEarth()
    earth.isCentralBody = True
    both = [_module("simulation.spacecraft").Spacecraft() for _ in range(2)]
    for k, craft in enumerate(both):
        craft.ModelTag = f"craft-{k}"
        craft.hub.mHub, craft.hub.IHubPntBc_B = MASS, np.reshape(INERTIA, (3, 3)).tolist()
        gravity.addBodiesTo(craft)
        sim.AddModelToTask("all", craft, 5)
    return both[0], both[1], earth.mu


def _actuators(sim: Any, deputy: Any) -> tuple[Any, Any, Any]:
    """Two thrusters of 22 N along one axis, a torque without limits, and the thrusters' message."""
    thrusters = _module("simulation.thrusterDynamicEffector").ThrusterDynamicEffector()
    torque = _module("simulation.extForceTorque").ExtForceTorque()
    factory = _module("utilities.simIncludeThruster").thrusterFactory()
    setup = _module("utilities.fswSetupThrusters")
    setup.clearSetup()
    for _ in range(2):
        factory.create("MOOG_Monarc_22_6", [0.0] * 3, [1.0] * 3, useMinPulseTime=False)
    factory.addToSpacecraft(deputy.ModelTag, thrusters, deputy)
    for one in factory.thrusterList.values():
        place, direction = (np.ravel(part).tolist() for part in (one.thrLoc_B, one.thrDir_B))
        setup.create(place, direction, one.MaxThrust)
    deputy.addDynamicEffector(torque)
    for model in (thrusters, torque):
        sim.AddModelToTask("all", model, 6)
    return thrusters, torque, setup.writeConfigMessage()


def _guidance(sim: Any, chief: Any, deputy: Any, thrusters: Any, torque: Any, config: Any) -> None:
    """Exact navigation, the burns' schedule, and attitude control by the example's gains."""
    messages = _module("architecture.messaging")
    known = messages.VehicleConfigMsgPayload()
    known.ISCPntB_B, known.massSC = list(INERTIA), MASS
    body = messages.VehicleConfigMsg().write(known)
    navigation = [_module("simulation.simpleNav").SimpleNav() for _ in range(2)]
    for one, craft in zip(navigation, (chief, deputy), strict=True):
        one.scStateInMsg.subscribeTo(craft.scStateOutMsg)
        sim.AddModelToTask("all", one, 4)
    burns = _module("fswAlgorithms.spacecraftReconfig").spacecraftReconfig()
    error = _module("fswAlgorithms.attTrackingError").attTrackingError()
    control = _module("fswAlgorithms.mrpFeedback").mrpFeedback()
    burns.chiefTransInMsg.subscribeTo(navigation[0].transOutMsg)
    burns.deputyTransInMsg.subscribeTo(navigation[1].transOutMsg)
    burns.thrustConfigInMsg.subscribeTo(config)
    burns.vehicleConfigInMsg.subscribeTo(body)
    burns.mu = _module("utilities.orbitalMotion").MU_EARTH * 1e9
    burns.attControlTime, burns.targetClassicOED = 400, TARGET
    thrusters.cmdsInMsg.subscribeTo(burns.onTimeOutMsg)
    error.attRefInMsg.subscribeTo(burns.attRefOutMsg)
    error.attNavInMsg.subscribeTo(navigation[1].attOutMsg)
    control.guidInMsg.subscribeTo(error.attGuidOutMsg)
    control.vehConfigInMsg.subscribeTo(body)
    control.K, control.Ki, control.P, control.integralLimit = 10, 2e-4, 50.0, 1e3
    torque.cmdTorqueInMsg.subscribeTo(control.cmdTorqueOutMsg)
    for model, priority in ((burns, 3), (error, 2), (control, 1)):
        sim.AddModelToTask("all", model, priority)


def _elements(orbits: Any, mu: float, position: Any, velocity: Any) -> Float[Array, "6"]:
    found = orbits.rv2elem(mu, position, velocity)
    anomaly = orbits.E2M(orbits.f2E(found.f, found.e), found.e)
    return np.array([found.a, found.e, found.i, found.Omega, found.omega, anomaly])
