"""A made-up pyrealsense2 with the calls that are used; the real one was seen to give the same."""

import time
from types import SimpleNamespace

import numpy as np

WIDTH, HEIGHT = 64, 48
UNIT = 0.0001


class FakeRealSense:
    """A module object: one camera, or one recording of so many images."""

    def __init__(
        self, fmt="rgb8", images=100, start_error=None, millimeters=700, missing="", coeffs=(0,) * 5
    ):
        self.stream = SimpleNamespace(depth="depth", color="color")
        self.format = SimpleNamespace(
            z16="z16", rgb8="rgb8", bgr8="bgr8", rgba8="rgba8", bgra8="bgra8", yuyv="yuyv"
        )
        self.fmt, self.images, self.start_error, self.missing = fmt, images, start_error, missing
        self.timestamp_domain = SimpleNamespace(global_time="global", system_time="system", hardware="own")
        self.domain, self.age = "own", 0.0
        self.millimeters, self.coeffs = millimeters, coeffs
        self.given, self.stopped, self.aligned, self.real_time = 0, 0, 0, True
        self.played, self.streams, self.serial = None, [], None

    def config(self):
        def play(file_name, repeat_playback=True):
            self.played = (file_name, repeat_playback)

        return SimpleNamespace(
            enable_stream=lambda *arguments: self.streams.append(arguments),
            enable_device_from_file=play,
            enable_device=lambda serial: setattr(self, "serial", serial),
        )

    def pipeline(self):
        def start(config):
            if self.start_error:
                raise RuntimeError(self.start_error)
            return SimpleNamespace(get_device=self.device)

        def stop():
            self.stopped += 1

        return SimpleNamespace(start=start, stop=stop, try_wait_for_frames=self.wait)

    def device(self):
        def set_real_time(value):
            self.real_time = value

        return SimpleNamespace(
            as_playback=lambda: SimpleNamespace(set_real_time=set_real_time),
            first_depth_sensor=lambda: SimpleNamespace(get_depth_scale=lambda: UNIT),
        )

    def wait(self, timeout_ms=5000):
        if self.given == self.images:
            return False, None
        self.given += 1
        return True, self.given - 1

    def align(self, to):
        assert to == "color"
        return SimpleNamespace(process=self.frames)

    def frames(self, number):
        self.aligned += 1
        channels = 4 if "a8" in self.fmt else 3
        pixels = np.zeros((HEIGHT, WIDTH, channels), np.uint8)
        pixels[..., 0 if self.fmt.startswith("rgb") else 2] = 200
        pixels[..., 1] = number
        depth = np.full((HEIGHT, WIDTH), self.millimeters * 0.001 / UNIT, np.uint16)
        lens = SimpleNamespace(
            width=WIDTH, height=HEIGHT, fx=60.0, fy=61.0, ppx=31.0, ppy=24.0, coeffs=list(self.coeffs)
        )
        profile = SimpleNamespace(format=lambda: self.fmt, get_intrinsics=lambda: lens)
        profile.as_video_stream_profile = lambda: profile
        color = SimpleNamespace(get_data=lambda: pixels, profile=profile)
        return SimpleNamespace(
            get_depth_frame=lambda: (
                None
                if self.missing == "depth"
                else SimpleNamespace(
                    get_data=lambda: depth,
                    get_frame_timestamp_domain=lambda: self.domain,
                    get_timestamp=lambda: 1000 * (time.time() - self.age),
                )
            ),
            get_color_frame=lambda: None if self.missing == "color" else color,
        )
