"""A laboratory's own recordings: from a folder of files to tables, contrasts and a report.

`analyse` is where to start.
"""
