# SPDX-License-Identifier: Apache-2.0
"""Model files as text, whatever simulates them: read as people write them, mended, changed in place, moved."""
