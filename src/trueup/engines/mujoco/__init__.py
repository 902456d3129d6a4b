# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulator: model files, what may be calibrated in them, batched rollouts, and writing the result back."""
