# SPDX-License-Identifier: BSD-3-Clause
from glob import glob

from setuptools import find_packages, setup

package = "piezo_controller"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={package: ["py.typed", "*.yaml", "**/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
        ("share/" + package + "/config", glob("config/*.yaml")),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="Control of a piezo-actuated stage: inverse feedforward, H-infinity feedback.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "controller = piezo_controller.node.start:main",
            "design = piezo_controller.commands.design_command:main",
            "scan = piezo_controller.commands.scan_command:main",
        ],
    },
)
