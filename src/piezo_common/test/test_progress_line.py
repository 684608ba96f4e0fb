# SPDX-License-Identifier: BSD-3-Clause
import io

from piezo_common.progress_line import ProgressLine, progress_text


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_one_line_that_is_written_over():
    terminal = Terminal()
    progress = ProgressLine(terminal)
    progress.show("creep", 0.25, 12.0)
    progress.show("dynamics", 0.5, 8.0)
    progress.clear()
    assert "\n" not in terminal.getvalue()
    assert terminal.getvalue().count("\r\x1b[K") == 3
    assert terminal.getvalue().endswith("\r\x1b[K\r")


def test_a_log_gets_one_line_for_each_step():
    log = io.StringIO()
    progress = ProgressLine(log)
    for step, fraction in (("creep", 0.1), ("creep", 0.2), ("dynamics", 0.3)):
        progress.show(step, fraction, 1.0)
    progress.clear()
    assert log.getvalue() == "creep\ndynamics\n"


def test_the_line_tells_step_fraction_and_seconds_left():
    assert progress_text("creep", 0.25, 12.3) == "[#####...............]  25 %   12 s left  creep"
    assert progress_text("rest", 1.0, None) == "[####################] 100 %              rest"
