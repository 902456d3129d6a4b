# SPDX-License-Identifier: Apache-2.0
"""A walk by phase, shift, shortening and swing for bipeds with legs of six joints."""
