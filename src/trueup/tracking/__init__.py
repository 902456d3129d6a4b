# SPDX-License-Identifier: Apache-2.0
"""Drives as they were tracked: where a vehicle was, headed where, commanded what, and what was known until then."""
