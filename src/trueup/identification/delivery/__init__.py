# SPDX-License-Identifier: Apache-2.0
"""What an identification hands over: a folder with the predictor, its source code, the model file, and how good each is."""
