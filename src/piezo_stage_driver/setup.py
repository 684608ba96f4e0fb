# SPDX-License-Identifier: BSD-3-Clause
from glob import glob

from setuptools import find_packages, setup

package = "piezo_stage_driver"

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
    description="The stage node over a backend: limits, watchdog, waveforms, feedback.",
    license="BSD-3-Clause",
    # The vendors' libraries: each is asked for only where its backend is chosen.
    extras_require={
        "nidaqmx": ["nidaqmx>=1,<2"],
        "nv200": ["nv200>=1.6,<2; python_version >= '3.12'"],
        "pi_gcs": ["pipython>=2.11,<3"],
    },
    entry_points={
        "console_scripts": [
            "stage = piezo_stage_driver.node.start:main",
        ],
        "piezo_stage_driver.backends": [
            "nidaqmx = piezo_stage_driver.backends.nidaqmx_stage:create",
            "nv200 = piezo_stage_driver.backends.nv200_stage:create",
            "pi_gcs = piezo_stage_driver.backends.pi_gcs_stage:create",
        ],
    },
)
