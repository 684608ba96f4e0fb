# SPDX-License-Identifier: BSD-3-Clause
from setuptools import find_packages, setup

package = "piezo_offline"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={package: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="The offline commands under one name, for people with and without ROS.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "piezo = piezo_offline.piezo_command:main",
        ],
    },
)
