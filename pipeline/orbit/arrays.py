"""Array types of relative motion: LVLH frame (x radial, y along-track, z cross-track), SI units.

A state is x y z vx vy vz in m and m/s, a control is an acceleration in m/s², constant over an
interval. n craft, T nodes, T-1 intervals.
"""

from jaxtyping import Bool, Float, Int

from pipeline.arrays import Array

Formation = Float[Array, "n 6"]
States = Float[Array, "n T 6"]
Controls = Float[Array, "n intervals 3"]
Marked = Bool[Array, "n"]  # some of n craft

AnyState = Float[Array, "*batch 6"]
AnyStates = Float[Array, "*batch T 6"]
AnyControls = Float[Array, "*batch intervals 3"]
Vector = Float[Array, "*batch 3"]
Scalar = Float[Array, "*batch"]

Indices = Int[Array, "k"]
Values = Float[Array, "k"]
Vectors = Float[Array, "k 3"]  # of k pairs, times or the like
