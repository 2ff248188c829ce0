"""How the shipped checkpoints were trained: a section of the results page."""

from __future__ import annotations

TRAINED = """## How the shipped checkpoints were trained

The shipped checkpoint `panda` is one model of PickCube, StackCube and PickYCB. It was trained on two of them, then on
all three, for an hour and a half in all on two CPU cores:

```
pwm-gym collect --task PickCube --episodes 900 --held-out 60 --practice 0.6
pwm-gym collect --task StackCube --episodes 900 --held-out 60 --practice 0.6
pwm-gym collect --task PickYCB --objects seen --episodes 800 --held-out 60 --practice 0.6
pwm-gym collect --task PickYCB --objects unseen --episodes 20 --held-out 80 --practice 0.4 \\
    --out data-sets/PickYCB-unseen
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/PickCube data-sets/StackCube --out runs/two \\
    --threads 1 --phases 1 2200 384 5 900 192 15 650 128
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/PickCube data-sets/StackCube data-sets/PickYCB \\
    --init runs/two/checkpoint --out runs/three --threads 1 --learning-rate 0.002 \\
    --phases 1 1200 384 5 800 192 15 800 128
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/PickCube data-sets/StackCube data-sets/PickYCB \\
    --init runs/three/checkpoint --out runs/panda --threads 1 --learning-rate 0.002 \\
    --phases 1 1500 384 5 600 192 15 600 128
```

`kitchen` went on from it with MugCleanup and Coffee, in four trainings of 32, 27, 14 and 16 minutes on the two cores
beside other work. It has initial scenes of CoffeePreparation and saw no data of it. From the second training on windows
draw the order of a cloud's points; the third and the fourth add practice, demonstrations that hold the mug about its
body (earlier ones hold it by its rim), and PickYCB's data. Of MugCleanup the first data set has 110 demonstrations and
80 episodes of practice: one collection was stopped during practice, and the next went on with fewer episodes.

```
pwm-gym collect --task Coffee --episodes 240 --held-out 30 --practice 0.5
pwm-gym collect --task MugCleanup --episodes 220 --held-out 24 --practice 0.5  # stopped during practice
pwm-gym collect --task MugCleanup --episodes 160 --held-out 20 --practice 0.5
pwm-gym collect --task MugCleanup --episodes 220 --held-out 1 --practice 1.0 --offset 1000 \\
    --out data-sets/MugCleanup-practice
pwm-gym collect --task MugCleanup --episodes 100 --held-out 1 --practice 0.2 --offset 2000 --shard 10 \\
    --out data-sets/MugCleanup-body
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/MugCleanup data-sets/Coffee --init panda \\
    --out runs/kitchen --threads 1 --learning-rate 0.002 --phases 1 900 256 5 700 128 15 500 64
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/MugCleanup data-sets/Coffee \\
    --init runs/kitchen/checkpoint --out runs/kitchen2 --threads 1 --learning-rate 0.0015 \\
    --phases 1 500 256 5 500 128 15 400 64
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/MugCleanup data-sets/MugCleanup-practice \\
    data-sets/Coffee data-sets/PickYCB --init runs/kitchen2/checkpoint --out runs/kitchen3 --threads 1 \\
    --learning-rate 0.0015 --phases 1 400 256 5 450 128 15 350 64
torchrun --nproc-per-node 2 -m pwm_gym train --data data-sets/MugCleanup data-sets/MugCleanup-practice \\
    data-sets/MugCleanup-body data-sets/Coffee data-sets/PickYCB --init runs/kitchen3/checkpoint --out runs/kitchen4 \\
    --threads 1 --learning-rate 0.0015 --phases 1 300 256 5 450 128 15 300 64
pwm-gym scenes runs/kitchen4/checkpoint --task MugCleanup  # and Coffee: demonstrations' first scenes alone
pwm-gym scenes runs/kitchen4/checkpoint --task CoffeePreparation
```

After that training its configuration got `hidden_gaps` of 1 and 7 cm, without a change of its weights: a loose object
that is near the robot and not touched does not change how the arm moves. Before, a pod in a drawer stopped the hand
that came down to it, where the simulator's hand goes on.

The rollouts of the three long tasks, the tables of `paper-small` and of baselines on PickYCB, of planning on StackCube,
and behaviour cloning were measured with data sets that were collected anew: the same seeds, and fewer training
episodes.

```
pwm-gym collect --task PickYCB --objects seen --episodes 360 --held-out 40 --practice 0.6
pwm-gym collect --task StackCube --episodes 360 --held-out 20 --practice 0.6
pwm-gym collect --task MugCleanup --episodes 16 --held-out 20 --practice 0.5
pwm-gym collect --task Coffee --episodes 16 --held-out 30 --practice 0.5
pwm-gym collect --task CoffeePreparation --episodes 16 --held-out 12 --practice 0.0  # baselines without learning alone
pwm-gym collect --task Coffee --episodes 64 --held-out 8 --practice 0.0  # for behaviour cloning
```

`fetch` and `fetch-grip` are of the Fetch: 19 and 24 minutes of one process beside others, and ten of collection.
`fetch` saw all four tasks and is the default of two; in these the gripper is held shut and its action ignored, so
that one response fitted on all four never opens a shut gripper. `fetch-grip` is of FetchPickAndPlace alone.
`fetch-slide` went on from `fetch` on FetchSlide alone, for 13 minutes of one processor beside others, in two trainings
whose weights' mean it is.

```
pwm-gym collect --task FetchPickAndPlace --episodes 700 --held-out 40 --practice 0.6
pwm-gym collect --task FetchPush --episodes 600 --held-out 40 --practice 0.6
pwm-gym collect --task FetchReach --episodes 150 --held-out 40 --practice 0.6
pwm-gym collect --task FetchSlide --episodes 400 --held-out 40 --practice 0.6
pwm-gym train --data data-sets/FetchPickAndPlace data-sets/FetchPush data-sets/FetchReach data-sets/FetchSlide \\
    --out runs/fetch --threads 1 --phases 1 1200 256 5 500 128 15 350 96
pwm-gym train --data data-sets/FetchPickAndPlace --out runs/fetch-grip --threads 1 \\
    --phases 1 900 256 5 400 128 15 300 96
pwm-gym collect --task FetchSlide --episodes 900 --held-out 40 --practice 0.6  # anew, for fetch-slide
pwm-gym train --data data-sets/FetchSlide --init fetch --out runs/slide --threads 1 --learning-rate 0.002 \\
    --phases 1 500 256 5 400 128 15 250 96
pwm-gym train --data data-sets/FetchSlide --init runs/slide/checkpoint --out runs/slide2 --threads 1 \\
    --learning-rate 0.0015 --phases 1 200 256 5 400 128 15 400 96
pwm-gym average runs/slide/checkpoint runs/slide2/checkpoint --out runs/slide3
```

`ogbench-cube` is of OGBench's single cube and its UR5e: 14 minutes of one processor, 36 by the clock beside many
others.

```
pwm-gym collect --task OGBenchCubeSingle --episodes 300 --held-out 40 --practice 0.6
pwm-gym train --data data-sets/OGBenchCubeSingle --out runs/cube --threads 1 --arm-steps 3000 --error-steps 1000 \\
    --phases 1 700 256 5 300 128 15 200 96
```

`ogbench-cubes` went on from it with two cubes, in two trainings of 19 minutes of one processor beside others. Its
rollouts are measured in more test episodes.

```
pwm-gym collect --task OGBenchCubeDouble --episodes 400 --held-out 30 --practice 0.5
pwm-gym collect --task OGBenchCubeDouble --episodes 400 --held-out 1 --practice 0.3 --offset 2000 \\
    --out data-sets/OGBenchCubeDouble-more
pwm-gym train --data data-sets/OGBenchCubeDouble --init ogbench-cube --out runs/cubes --threads 1 --arm-steps 1500 \\
    --error-steps 1000 --learning-rate 0.002 --phases 1 700 256 5 500 128 15 350 96
pwm-gym train --data data-sets/OGBenchCubeDouble data-sets/OGBenchCubeDouble-more --init runs/cubes/checkpoint \\
    --out runs/cubes2 --threads 1 --arm-steps 1500 --error-steps 1000 --learning-rate 0.002 \\
    --phases 1 150 256 5 350 128 15 450 96
pwm-gym collect --task OGBenchCubeDouble --episodes 1 --held-out 80 --practice 0.25 \\
    --out data-sets/OGBenchCubeDouble-test
```

`adroit-door` and `adroit-relocate` are of one task each: 30 minutes of one processor beside the other.

```
pwm-gym collect --task AdroitHandDoor --episodes 200 --held-out 24 --practice 0.3
pwm-gym collect --task AdroitHandRelocate --episodes 200 --held-out 24 --practice 0.3
pwm-gym train --data data-sets/AdroitHandDoor --out runs/door --threads 1 --phases 1 600 192 5 500 96 15 250 48
pwm-gym train --data data-sets/AdroitHandRelocate --out runs/ball --threads 1 --phases 1 600 192 5 500 96 15 250 48
```

`two-hands` is of both tasks of two arms, in four trainings on one processor of 18, 15, 30 and 33 minutes. The last two
also saw demonstrations with jitter, whose hands press unevenly on a lid, and go on to rollouts of 30 steps; before,
lid and mug drifted sideways with the hands. What ships is the mean of their weights, which foresees the rewards of the
validation episodes of the box as well as the last, and those of the drawer better than either.

```
pwm-gym collect --task TwoArmBoxCleanup --episodes 160 --held-out 14 --practice 0.4 --shard 10
pwm-gym collect --task TwoArmDrawerCleanup --episodes 150 --held-out 14 --practice 0.4 --shard 10
pwm-gym train --data data-sets/TwoArmBoxCleanup --out runs/box --threads 1 --phases 1 420 128 5 260 48 15 130 32
pwm-gym train --data data-sets/TwoArmDrawerCleanup data-sets/TwoArmBoxCleanup --init runs/box/checkpoint \\
    --out runs/hands --threads 1 --learning-rate 0.002 --phases 1 200 128 5 200 48 15 100 32
pwm-gym collect --task TwoArmBoxCleanup --episodes 110 --held-out 11 --practice 0 --randomise 0 --jitter 0.15 \\
    --offset 2000 --shard 10 --out data-sets/TwoArmBoxCleanup-jitter
pwm-gym collect --task TwoArmDrawerCleanup --episodes 60 --held-out 6 --practice 0 --randomise 0 --jitter 0.15 \\
    --offset 2000 --shard 10 --out data-sets/TwoArmDrawerCleanup-jitter
pwm-gym train --data data-sets/TwoArmBoxCleanup data-sets/TwoArmBoxCleanup-jitter data-sets/TwoArmDrawerCleanup \\
    data-sets/TwoArmDrawerCleanup-jitter --init runs/hands/checkpoint --out runs/hands4 --threads 1 \\
    --learning-rate 0.002 --phases 1 300 128 5 500 48 15 350 32
pwm-gym train --data data-sets/TwoArmBoxCleanup data-sets/TwoArmBoxCleanup-jitter data-sets/TwoArmDrawerCleanup \\
    data-sets/TwoArmDrawerCleanup-jitter --init runs/hands4/checkpoint --out runs/hands5 --threads 1 \\
    --learning-rate 0.0015 --phases 5 200 48 15 350 32 30 150 16
pwm-gym average runs/hands4/checkpoint runs/hands5/checkpoint --shares 1 2 --out runs/hands6
pwm-gym evaluate --task TwoArmDrawerCleanup --checkpoint runs/hands6 --split validation  # as of each, and of the box
```
"""
