"""Things by name: named, named with settings, or taken from code.

What methods and scenarios share: ``arx(memory=none)``, ``file.py:Mine(order=3)``.  Imports
types only.  Start at `settings` (text to objects and back), then `code` (objects out
of files and modules, also in another process).
"""
