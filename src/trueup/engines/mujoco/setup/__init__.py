# SPDX-License-Identifier: Apache-2.0
"""What recordings say of a model before anything is fitted: drives, scales, bases, and what to calibrate."""
