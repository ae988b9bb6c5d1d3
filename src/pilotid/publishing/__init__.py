"""Several studies: pages that show them side by side, and what changed from one to another.

Made from the stores alone, whose methods need not be installed.
"""
