"""``pwm-gym publish``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pwm_gym.errors import PwmGymError

__all__ = ["Publish"]


@dataclass(frozen=True)
class Publish:
    """Put a checkpoint with a model card into a folder, or upload it to the Hugging Face hub (extra "hub")."""

    checkpoint: str
    """A folder or a shipped checkpoint's name."""
    out: Path | None = None
    """Folder to write."""
    repository: str = ""
    """Repository "owner/name" to upload to, as who is logged in by `hf auth login`."""
    private: bool = False
    """Whether a new repository is private."""

    def run(self) -> None:
        """Write or upload, and print where it is."""
        from pwm_gym.dynamics import push_to_hub, save_pretrained

        if (self.out is None) == (not self.repository):
            raise PwmGymError("expected either --out FOLDER or --repository owner/name")
        if self.out is not None:
            print(save_pretrained(self.checkpoint, self.out))
        else:
            print(push_to_hub(self.checkpoint, self.repository, self.private))
