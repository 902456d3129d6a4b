# SPDX-License-Identifier: Apache-2.0
"""Two papers on identifying an industrial arm, done again in simulation with what they leave open as factors."""
