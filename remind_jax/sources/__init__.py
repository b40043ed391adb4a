"""Where frames come from: video, folders, DAVIS, ScanNet++, arrays, features."""
