"""Replays the samples of a run as a video, so that a person sees how the agent fails."""

from sada_gym.analyses.replay.video import ReplayedSample, Video, replay

__all__ = ["ReplayedSample", "Video", "replay"]
