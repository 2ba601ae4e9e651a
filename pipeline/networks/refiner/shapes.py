"""Shapes of the refiner's arrays, numpy's or torch's.

Axes: b swarms of n craft, N craft in all, T nodes, m = 3(T-1) controls, E encounters, L of them
with planes, C craft with planes, F features, H numbers of a message.
"""

from typing import Any

from pipeline.arrays import Float

AnyEndStates = Float[Any, "b n 6"]
FlatControls = Float[Any, "N m"]
PerSwarm = Float[Any, "b"]
PerPlane = Float[Any, "L"]
PerSide = Float[Any, "L 2"]  # for either craft of a plane
PlaneVectors = Float[Any, "L 3"]
Gains = Float[Any, "L m"]  # effects of a craft's controls
RelativeEnds = Float[Any, "L 2 6"]  # first craft less second, at both ends of the interval
