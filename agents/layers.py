"""The name by which models saved before the first release refer to tanh, so that `PPO.load` reads them."""

from torch.nn import Tanh as Tanh
