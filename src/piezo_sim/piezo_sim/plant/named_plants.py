# SPDX-License-Identifier: BSD-3-Clause
"""The plants that have a name, and the files of the package that describe them."""

PLANTS = {"default": "plant.yaml", "undeclared": "undeclared.yaml", "beam": "beam.yaml"}
"""That of thesis chapter 4, the same with two effects that no model is told of, and one of another
mathematical form than any model; with the file of this package that describes each."""

AXES_PLANTS = {"xy": "xy.yaml", "serial": "serial.yaml"}
"""Two axes: a platform that two actuators push beside each other, and a slow axis that carries the
fast one; with the file of this package that describes each."""
