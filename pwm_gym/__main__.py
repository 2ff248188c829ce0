"""``python -m pwm_gym``, and ``torchrun -m pwm_gym``."""

from pwm_gym.cli import main

if __name__ == "__main__":
    main()
