# SPDX-License-Identifier: BSD-3-Clause
"""Study of the delay and the false alarms with which the monitor reports a doubled model error."""
