"""The page in a browser: grasps that follow the mouse, episodes that play, results, logs, captures and hands.

Extra ``viewer``. ``view`` (``fungrasp.view``) decides between it and a page on disk.
"""
