"""From a few depth images of an object on a table to its mesh."""

from fungrasp.perception.scan.scan_object import ObjectScan, ScanSettings, scan_object

__all__ = ["ObjectScan", "ScanSettings", "scan_object"]
