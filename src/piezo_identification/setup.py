# SPDX-License-Identifier: BSD-3-Clause
from glob import glob

from setuptools import find_packages, setup

package = "piezo_identification"

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
    description="Identification of a piezo-actuated stage: experiments and estimators.",
    license="BSD-3-Clause",
    entry_points={
        "console_scripts": [
            "identification = piezo_identification.node.start:main",
            "monitor = piezo_identification.node.start:monitor",
            "measured = piezo_identification.node.moved:measured",
            "check = piezo_identification.commands.check_command:main",
            "diagnose = piezo_identification.commands.diagnose_command:main",
            "diagnose_many = piezo_identification.commands.diagnose_many_command:main",
            "propose = piezo_identification.commands.propose_command:main",
            "identify = piezo_identification.commands.identify_command:main",
            "simulate = piezo_identification.commands.simulate_command:main",
            "waveforms = piezo_identification.commands.waveforms_command:main",
        ],
    },
)
