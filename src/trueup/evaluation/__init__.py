# SPDX-License-Identifier: Apache-2.0
"""Where candidates are evaluated: on this machine's cores, or on the workers of a cluster."""
