# SPDX-License-Identifier: BSD-3-Clause
from glob import glob

from setuptools import find_packages, setup

package = "piezo_bringup"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={package: ["py.typed", "*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
        ("share/" + package + "/launch", glob("launch/*.launch.py")),
        ("share/" + package + "/config", glob("config/*")),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="Launch files, parameters and viewer layouts of the piezo stage packages.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "demo = piezo_bringup.moved:demo",
            "diagnose_suite = piezo_bringup.moved:diagnose_suite",
            "suite = piezo_bringup.suite_command:main",
        ],
    },
)
