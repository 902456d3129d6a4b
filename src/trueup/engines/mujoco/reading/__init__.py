# SPDX-License-Identifier: Apache-2.0
"""Model files as people have them, made to compile."""
