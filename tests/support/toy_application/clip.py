"""The ball as a clip."""

from PIL import Image

from sada_gym.clips.shots import Clip, Shot, ShotEnding


def clip(application, mu, seed, seconds):
    """Show the slope, and nothing else."""
    score = float(application.evaluate(mu[None], [seed]).score[0])
    pictures = [Image.fromarray(application.render(mu, seed))] * 3
    ending = ShotEnding("the ball has stopped", failed=score <= application.fooling_threshold)
    return Clip([Shot(pictures, 4.0, ["rolling"] * 3, "slopes", ending)], score)
