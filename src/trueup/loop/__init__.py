# SPDX-License-Identifier: Apache-2.0
"""The loop, one verb a file: plain functions, usable in a notebook."""
