"""The interactive viewer: grasps, episodes, results, logs, captures and hands in a browser.

It needs the extra ``viewer``. ``fungrasp.view`` opens it or writes a static page.
"""
