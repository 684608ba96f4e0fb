# SPDX-License-Identifier: BSD-3-Clause
from glob import glob

from setuptools import find_packages, setup

package = "piezo_recorder"

setup(
    name=package,
    version="0.2.0",
    packages=find_packages(include=[package, package + ".*"]),
    package_data={package: ["*.yaml", "py.typed", "writing/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package]),
        ("share/" + package, ["package.xml"]),
        ("share/" + package + "/config", glob("config/*.yaml")),
    ],
    zip_safe=False,
    maintainer="The maintainers",
    maintainer_email="maintainers@example.org",
    description="Recording of stage samples as rosbag2 MCAP, and the reader of recordings.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "recorder = piezo_recorder.node.start:main",
            "convert = piezo_recorder.commands.convert_command:main",
            "repair = piezo_recorder.commands.repair_command:main",
            "report = piezo_recorder.commands.report_command:main",
            "image = piezo_recorder.commands.image_command:main",
        ],
    },
)
