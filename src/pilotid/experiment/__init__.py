"""An experiment: from a folder of files to tables, contrasts and a report.

`pilotid.experiment.experiment.analyse` is where to start.
"""
