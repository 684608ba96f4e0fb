# SPDX-License-Identifier: BSD-3-Clause
from setuptools import find_packages, setup

package = "piezo_studies"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="Studies with the suite: demo, thesis, measured devices, diagnosis benchmark.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "demo = piezo_studies.demo.demo_command:main",
            "diagnose_suite = piezo_studies.diagnosis_benchmark.suite_command:main",
            "measured = piezo_studies.measured_devices.measured_command:main",
        ],
    },
)
