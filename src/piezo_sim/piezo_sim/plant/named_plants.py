# SPDX-License-Identifier: BSD-3-Clause
"""The plants with names, and the files of the package that describe them."""

PLANTS = {"default": "plant.yaml", "undeclared": "undeclared.yaml", "beam": "beam.yaml"}
"""The plant of thesis chapter 4, the same with two effects that models do not contain, and one of
another mathematical form than any model; with the file of this package that describes each."""

AXES_PLANTS = {"xy": "xy.yaml", "serial": "serial.yaml"}
"""Plants of two axes: a platform with an actuator for each direction, and a slow axis that carries
the fast one; with the file of this package that describes each."""
