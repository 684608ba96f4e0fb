# SPDX-License-Identifier: BSD-3-Clause
from glob import glob

from setuptools import find_packages, setup

package = "piezo_sim"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={package: ["*.yaml", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
        ("share/" + package + "/config", glob("config/*.yaml")),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="A simulated piezo-actuated stage behind the stage node.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "stage_sim = piezo_sim.node.start:main",
            "specimen = piezo_sim.specimen.specimen_command:main",
        ],
    },
)
