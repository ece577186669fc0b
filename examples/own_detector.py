"""A detector of your own: in which views and colours does it miss the car?

    python examples/own_detector.py

The detector keeps torchvision's calling convention, so that torchvision's own take its place:

    from torchvision.models.detection import FasterRCNN_ResNet50_FPN_V2_Weights as Weights
    from torchvision.models.detection import fasterrcnn_resnet50_fpn_v2

    detector = fasterrcnn_resnet50_fpn_v2(weights=Weights.DEFAULT).eval()
    labels = {"car": Weights.DEFAULT.meta["categories"].index("car")}  # 3

Such a network is slow on a processor: begin with a budget of 100.
"""

import torch
from torch import Tensor

from sada_gym import attack

CAR = 3  # the number that this detector gives a car; torchvision's COCO models give it the same


class ByContrast(torch.nn.Module):
    """Sees a car where the middle of the picture has another colour than what surrounds it.

    It is a stand-in for a detector of yours: no network, no training.
    """

    def __init__(self) -> None:
        super().__init__()
        self.usual = torch.nn.Parameter(torch.tensor(0.1))  # contrast at which it is half sure
        self.sharpness = torch.nn.Parameter(torch.tensor(25.0))

    def forward(self, images: list[Tensor]) -> list[dict[str, Tensor]]:
        """Detect cars in images, each (3, H, W) float32 in [0, 1]; one dictionary an image."""
        return [self.detect(image) for image in images]

    def detect(self, image: Tensor) -> dict[str, Tensor]:
        """Return boxes (N, 4) in pixels (x0 y0 x1 y1), labels (N,) and scores (N,), N <= 1."""
        rows, columns = image.shape[1:]
        box = torch.tensor([columns / 4, rows / 3, columns * 3 / 4, rows * 2 / 3])
        x0, y0, x1, y1 = box.int().tolist()
        inside = torch.zeros(rows, columns, dtype=torch.bool)
        inside[y0:y1, x0:x1] = True
        contrast = (image[:, inside].mean(1) - image[:, ~inside].mean(1)).norm()
        score = torch.sigmoid(self.sharpness * (contrast - self.usual))
        found = int(score > 0.05)  # nothing found is an empty answer
        return {
            "boxes": box[None][:found],
            "labels": torch.tensor([CAR])[:found],
            "scores": score[None][:found],
        }


def main() -> None:
    """Attack the detector, and say how often random and learnt worlds fool it."""
    world = {"object_class": "car", "agent": ByContrast().eval(), "labels": {"car": CAR}}
    env = "SADA-Detection-v0"
    # where nearly all random worlds fool a good detector, the label is wrong
    found = attack(
        env, "random", budget=0, samples=100, env_kwargs=world, out="runs/any-car", resume=True
    )
    print(f"{found.result.afr:.0%} of random worlds fool the detector")
    found = attack(
        env, "level-set", budget=1_000, env_kwargs=world, out="runs/missed-car", resume=True
    )
    print(f"{found.result.afr:.0%} of the learnt worlds fool it")
    print(f"pictures of them: {found.folder}/fooled.png")


if __name__ == "__main__":
    main()
