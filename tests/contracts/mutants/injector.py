"""Injectors that each break one promise, and what is found."""

from dataclasses import replace

import torch
from torch import nn

from anystyle.testing.toy.injector import ToyInjector


class Fixed(ToyInjector):
    def __init__(self, *, dim: int, style_dim: int):
        super().__init__(dim=64, style_dim=style_dim)


class WithoutSpecials(ToyInjector):
    def forward(self, tokens, style):
        return replace(tokens, data=super().forward(tokens, style).patches)


class Born(ToyInjector):
    def __init__(self, *, dim: int, style_dim: int):
        super().__init__(dim=dim, style_dim=style_dim)
        nn.init.normal_(self.scale.bias, std=1e-4)


class Unused(ToyInjector):
    def __init__(self, *, dim: int, style_dim: int):
        super().__init__(dim=dim, style_dim=style_dim)
        self.spare = nn.Linear(dim, dim)


class TwiceZero(ToyInjector):
    def __init__(self, *, dim: int, style_dim: int):
        super().__init__(dim=dim, style_dim=style_dim)
        self.gate = nn.Parameter(torch.zeros(()))

    def forward(self, tokens, style):
        change = super().forward(tokens, style).data - tokens.data
        return tokens.with_data(tokens.data + self.gate * change)


class Deaf(ToyInjector):
    def forward(self, tokens, style):
        return super().forward(tokens, torch.ones_like(style))


class Mixed(ToyInjector):
    def forward(self, tokens, style):
        return super().forward(tokens, style - 0.5 * style.mean(0, keepdim=True))


class FirstViewOnly(ToyInjector):
    def forward(self, tokens, style):
        changed = super().forward(tokens, style).data
        return tokens.with_data(torch.cat([changed[:, :1], tokens.data[:, 1:]], dim=1))


class InPlace(ToyInjector):
    def forward(self, tokens, style):
        with torch.no_grad():
            tokens.data.add_(1e-3 * self.scale.bias.detach().sign())
        return super().forward(tokens, style)


class Detached(ToyInjector):
    def forward(self, tokens, style):
        return super().forward(tokens, style.detach())


CHANGED = {
    "as it is": (ToyInjector, set()),
    "for one width": (Fixed, {"fits every site"}),
    "special tokens dropped": (WithoutSpecials, {"fits every site"}),
    "not the identity": (Born, {"changes nothing at birth"}),
    "a layer too many": (Unused, {"learns everywhere by the second step"}),
    "a product of two zeros": (
        TwiceZero,
        {"learns everywhere by the second step", "style matters after training", "gradients reach tokens and style"},
    ),
    "style unused": (Deaf, {"style matters after training", "gradients reach tokens and style"}),
    "styles of a batch mixed": (Mixed, {"styles of a batch stay apart"}),
    "the first view alone": (FirstViewOnly, {"views have no order"}),
    "tokens overwritten": (InPlace, {"tokens are not overwritten"}),
    "style without gradient": (Detached, {"gradients reach tokens and style"}),
}
