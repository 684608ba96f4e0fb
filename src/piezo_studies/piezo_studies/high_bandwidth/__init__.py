# SPDX-License-Identifier: BSD-3-Clause
"""Study of feedbacks at the sample clock's rate whose bandwidth lies beyond the first mode."""
