# SPDX-License-Identifier: BSD-3-Clause
from setuptools import find_packages, setup

package = "piezo_ros"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={package: ["py.typed", "*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="What the node modules share: spinning, parameters, action helpers.",
    license="BSD-3-Clause",
)
