"""The paper's siamese ResNet-9 and the swift network, in torch: from ``virtual_camera.network_input`` to a quaternion.

Details that the paper ("Training Details") leaves open: the first convolution is 8 x 8 with stride 4
(in place of ResNet's 7 x 7 with stride 2 and pooling, which cost three times as much for the same resolution), channels
are 32, 64 and 64, and each further stage halves the resolution: 64 channels of 8 x 8 flatten to the stated 4096.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from reorient.learning.recipes import NetworkName

Images = Float[Tensor, "n 2 128 128"]
Quaternions = Float[Tensor, "n 4"]


def convolution(inputs: int, outputs: int, kernel: int, stride: int = 1, padding: int | None = None) -> nn.Sequential:
    """A convolution followed by batch norm."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2 if padding is None else padding, bias=False),
        nn.BatchNorm2d(outputs),
    )


def near_identity(last: nn.Linear) -> nn.Linear:
    """Initialise the last layer to predict almost "no rotation"; otherwise training stays at a constant for long."""
    with torch.no_grad():
        last.weight.mul_(0.1)
        last.bias.copy_(torch.tensor([1.0, 0.0, 0.0, 0.0]))
    return last


class Residual(nn.Module):
    """Two convolutions with an identity path, which has a convolution where the shape changes."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.first = convolution(inputs, outputs, 3, stride)
        self.second = convolution(outputs, outputs, 3)
        self.identity = nn.Identity() if inputs == outputs and stride == 1 else convolution(inputs, outputs, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        """ReLU of the sum of both paths."""
        return F.relu(self.second(F.relu(self.first(x))) + self.identity(x))


class PaperNetwork(nn.Module):
    """Five convolutions with batch norm per image, one on the identity path; then a head on both images (Figure 2)."""

    def __init__(self, dropout: float) -> None:
        super().__init__()
        self.embed = nn.Sequential(
            convolution(1, 32, 8, 4, padding=2),
            nn.ReLU(),
            convolution(32, 64, 3, 2),
            nn.ReLU(),
            Residual(64, 64, 2),
            nn.Flatten(),
            nn.Linear(4096, 1024),
        )
        self.head = nn.Sequential(
            nn.Linear(2048, 1000),
            nn.LeakyReLU(0.02),
            nn.Dropout(dropout),
            nn.Linear(1000, 1000),
            nn.LeakyReLU(0.02),
            nn.Dropout(dropout),
            near_identity(nn.Linear(1000, 4)),
        )

    def forward(self, images: Images) -> Quaternions:
        """Unit quaternions of the rotation from the first image's object to the second's, virtual camera axes."""
        both = self.embed(torch.cat([images[:, :1], images[:, 1:]]))  # one pass: the same batch norm for both
        n = images.shape[0]
        return F.normalize(self.head(torch.cat([both[:n], both[n:]], dim=1)).float(), dim=1)


class SwiftNetwork(nn.Module):
    """Both images as channels of one input, so that early layers can compare pixels at the same position.

    4 x 4 patches become channels: no layer works at full resolution.
    """

    def __init__(self, dropout: float, channels: tuple[int, int, int] = (32, 64, 128)) -> None:
        super().__init__()
        a, b, c = channels
        self.features = nn.Sequential(
            nn.PixelUnshuffle(4),
            convolution(32, a, 3),
            nn.ReLU(),
            convolution(a, b, 3, 2),
            nn.ReLU(),
            Residual(b, b),
            Residual(b, c, 2),
            Residual(c, c),
            nn.Flatten(),
            nn.Linear(64 * c, 256),
            nn.ReLU(),
            nn.Dropout(dropout),
            near_identity(nn.Linear(256, 4)),
        )

    def forward(self, images: Images) -> Quaternions:
        """Unit quaternions of the rotation from the first image's object to the second's, virtual camera axes."""
        return F.normalize(self.features(images).float(), dim=1)


def build(name: NetworkName, dropout: float = 0.0) -> nn.Module:
    """An untrained network by name."""
    return PaperNetwork(dropout) if name == "paper" else SwiftNetwork(dropout)
