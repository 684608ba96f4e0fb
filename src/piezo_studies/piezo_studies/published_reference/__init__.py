# SPDX-License-Identifier: BSD-3-Clause
"""Study of the preview of a reference that is published while the stage follows it."""
