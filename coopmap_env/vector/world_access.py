"""Looking into the worlds of a vector environment, wherever they are."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import Any, Generic, TypeVar

WorldT = TypeVar("WorldT")


@contextlib.contextmanager
def naming_world(world: int) -> Iterator[None]:
    """Add the world to errors."""
    try:
        yield
    except Exception as error:
        error.add_note(f"in world {world}")
        raise


class WorldAccess(ABC, Generic[WorldT]):
    """Methods that reach single worlds; `MappingVectorEnv` has them."""

    n_worlds: int

    @abstractmethod
    def world(self, index: int) -> WorldT:
        """The environment of one world, to look at: its belief, its truth, a picture.

        Raises
        ------
        IndexError
            If there is no such world.
        RuntimeError
            If it is in another process; `apply` works there.
        """

    def apply(
        self, function: Callable[..., Any], *arguments: Any, worlds: Sequence[int] | None = None
    ) -> list[Any]:
        """Results of ``function(world, *arguments)``, where the worlds are: in their processes.

        Parameters
        ----------
        function : callable
            Gets what `world` gives, such as ``lambda env: env.belief().map.observed_fraction``.
        *arguments
            Further arguments.
        worlds : sequence of int, optional
            Which; by default all.
        """
        return [function(self.world(world), *arguments) for world in self._check_worlds(worlds)]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Results of a method of each world; see `apply`."""
        return tuple(self.apply(_call, name, args, kwargs))

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of each world, such as ``"agents"`` or ``"settings.camera"``."""
        return tuple(self.apply(attrgetter(name)))

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each world: to one value, or to those of a list or tuple."""
        each = values if isinstance(values, list | tuple) else [values] * self.n_worlds
        if len(each) != self.n_worlds:
            raise ValueError(f"{self.n_worlds} worlds need as many values, got {len(each)}")
        for world, value in enumerate(each):
            self.apply(setattr, name, value, worlds=[world])

    def render(self) -> tuple[Any, ...]:
        """The picture of each world."""
        return self.call("render")

    def _check_worlds(self, worlds: Sequence[int] | None) -> list[int]:
        if worlds is None:
            return list(range(self.n_worlds))
        for world in worlds:
            if not 0 <= world < self.n_worlds:
                raise IndexError(f"worlds are 0 to {self.n_worlds - 1}, got {world}")
        return list(worlds)


def _call(env: Any, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return getattr(env, name)(*args, **kwargs)
