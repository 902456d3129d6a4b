# SPDX-License-Identifier: Apache-2.0
"""What columns mean, one dialect a file: words propose, numbers check, `engine.guess` chooses; each rule has examples."""
