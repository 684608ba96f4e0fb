# SPDX-License-Identifier: BSD-3-Clause
"""Implementation of `scan`: plan the voltages; write, print and draw them."""

import argparse

from piezo_common.command_line import print_next
from piezo_common.picture_style import to_png
from piezo_controller.axes.path_plan import PathPlan
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import BEGIN_FILE, PERIOD_FILE, stored_scan, write_scan
from piezo_controller.commands.scan_command import OF_PATTERN

OF_PLAN = ("file", "voltage_range_v", "slew_limit_v_per_s", "sensor_delay_s")


def plan_of(options: argparse.Namespace) -> PathPlan:
    """Return the plan that the options of `add_path_options` ask for."""
    given = {name: value for name in (*OF_PATTERN, *OF_PLAN)
             if (value := getattr(options, name)) is not None}
    return scan(options.model, options.pattern, **given)


def plan_scan(options: argparse.Namespace) -> None:
    """Plan the path; write its voltages and a figure, and print what to expect."""
    plan = plan_of(options)
    write_scan(stored_scan(plan), options.output)
    period, begin, picture = (
        options.output / name for name in (PERIOD_FILE, BEGIN_FILE, "path.png"))
    print(plan.summary())
    picture.write_bytes(to_png(plan.plot()))
    print(f"one period, to be repeated: {period}; from the operating point into it: {begin}")
    print(f"drawn {picture}")
    print_next(options, "piezo_identification", "simulate", "--model", options.model, "--data",
               "<a recording of these voltages>", "--output", options.output)
