"""The driving law against a unicycle with limited acceleration, and one without."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dssmsg.frame import Camera, Frame
from dssmsg.interfaces.source import Command
from dssmsg.navigation.drive import Driver, wrap_angle

CAMERA = Camera(4, 3, 4.0, 4.0, 1.5, 1.0)
PERIOD = 0.2


class Unicycle:
    """Two control steps a frame; each approaches the commanded speeds as fast as its acceleration lets it."""

    def __init__(self, x=0.0, y=0.0, heading=0.0, linear_acc=1.0, angular_acc=3.0):
        self.x, self.y, self.heading, self.tilt, self.pan = x, y, heading, 0.0, 0.0
        self.linear = self.angular = 0.0
        self.limits = (linear_acc, angular_acc)
        self.index = 0
        self.trail = [(x, y)]
        self.headings = [heading]

    def step(self, command: Command) -> None:
        for _control in range(2):
            for _physics in range(24):
                dt = PERIOD / 48
                self.linear += np.clip(
                    command.linear - self.linear, -self.limits[0] * dt, self.limits[0] * dt
                )
                self.angular += np.clip(
                    command.angular - self.angular, -self.limits[1] * dt, self.limits[1] * dt
                )
                self.heading += self.angular * dt
                self.x += self.linear * math.cos(self.heading) * dt
                self.y += self.linear * math.sin(self.heading) * dt
                self.trail.append((self.x, self.y))
                self.headings.append(self.heading)
        self.tilt, self.pan = command.tilt, command.pan
        self.index += 1

    def frame(self) -> Frame:
        base = np.eye(4)
        c, s = math.cos(self.heading), math.sin(self.heading)
        base[:2, :2] = [[c, -s], [s, c]]
        base[:2, 3] = self.x, self.y
        down = -self.tilt
        camera = np.eye(4)
        c, s = math.cos(self.heading + self.pan), math.sin(self.heading + self.pan)
        camera[:3, 0] = [s, -c, 0]
        camera[:3, 2] = [c * math.cos(down), s * math.cos(down), -math.sin(down)]
        camera[:3, 1] = np.cross(camera[:3, 2], camera[:3, 0])
        camera[:3, 3] = [self.x, self.y, 0.9]
        return Frame(
            index=self.index,
            sim_time=self.index * PERIOD,
            rgb=np.zeros((3, 4, 3), np.uint8),
            depth=np.zeros((3, 4), np.float32),
            camera=CAMERA,
            world_from_camera=camera,
            world_from_base=base,
        )


def drive(robot, driver, points, tilt=-0.35, limit=400):
    frames = 0
    for number, point in enumerate(points):
        then = points[number + 1] if number + 1 < len(points) else None
        while (command := driver.drive_to(robot.frame(), point, tilt, then=then)) is not None:
            robot.step(command)
            frames += 1
            assert frames < limit, "never arrived"
    return frames


def look(robot, driver, heading, tilt=0.0, limit=100):
    frames = 0
    while (command := driver.look(robot.frame(), heading, tilt)) is not None:
        robot.step(command)
        frames += 1
        assert frames < limit, "never settled"
    return frames


def distance_to_line(trail, start, end):
    (ax, ay), (bx, by) = start, end
    length = math.dist(start, end)
    return max(abs((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / length for x, y in trail)


@pytest.mark.parametrize("degrees", [5, 20, 60, -60, 120, 179, -179])
@pytest.mark.parametrize("acceleration", [3.0, 1e6])
def test_look_settles_within_a_degree_without_overshoot(degrees, acceleration):
    robot, goal = Unicycle(angular_acc=acceleration), math.radians(degrees)
    look(robot, Driver(), goal, tilt=-0.4)
    assert abs(wrap_angle(goal - robot.heading)) <= math.radians(1.0)
    assert abs(robot.frame().tilt_rad + 0.4) < 1e-6
    past = max(math.copysign(1, goal) * h for h in robot.headings) - abs(goal)
    assert past <= math.radians(1.0)
    robot.step(Command())
    assert abs(wrap_angle(goal - robot.heading)) <= math.radians(1.2)  # it was at rest


def test_sixty_degrees_take_seven_frames():
    assert look(Unicycle(), Driver(), math.radians(60)) <= 7
    assert look(Unicycle(), Driver(), math.radians(-60)) <= 7


def test_look_crosses_pi_the_short_way():
    robot = Unicycle(heading=math.radians(170))
    look(robot, Driver(), math.radians(-170))
    assert max(robot.headings) < math.radians(192)
    assert min(robot.headings) > math.radians(169)


@pytest.mark.parametrize("acceleration", [3.0, 1e6])
def test_gaze_arrives_before_the_base_and_stays(acceleration):
    robot, driver, goal = Unicycle(angular_acc=acceleration), Driver(), math.radians(140)
    for frames in range(20):
        if frames >= 2:  # the first period tells how fast the robot accelerates
            assert abs(wrap_angle(robot.frame().heading_rad - goal)) <= math.radians(1.0)
        robot.step(driver.gaze(robot.frame(), goal, -0.4))
    assert abs(robot.heading - goal) <= math.radians(1.0)
    assert abs(robot.pan) <= math.radians(1.0)


def test_look_brings_the_pan_back():
    robot, driver = Unicycle(), Driver()
    robot.step(driver.gaze(robot.frame(), 1.5, 0.0))
    assert robot.pan > 1.0
    look(robot, driver, 0.5)
    assert robot.pan == 0.0
    assert robot.heading == pytest.approx(0.5, abs=math.radians(1.0))


def test_look_gives_up_on_a_tilt_the_mount_cannot_reach():
    robot = Unicycle()
    robot.step = lambda command, step=robot.step: (
        step(command),
        setattr(robot, "tilt", max(command.tilt, -0.3)),
    )
    assert look(robot, Driver(), 0.0, tilt=-1.2) <= 3
    assert robot.tilt == -0.3


@pytest.mark.parametrize(
    "goal", [(2.0, 0.0), (1.0, 1.0), (-1.5, 0.3), (0.0, -0.7), (0.12, 0.05), (-0.1, 0.0)]
)
@pytest.mark.parametrize("acceleration", [(1.0, 3.0), (1e6, 1e6)])
def test_drive_arrives_at_rest_on_the_straight_line(goal, acceleration):
    robot = Unicycle(linear_acc=acceleration[0], angular_acc=acceleration[1])
    drive(robot, Driver(), [goal])
    for _ in range(3):
        robot.step(Command())
    assert math.dist((robot.x, robot.y), goal) <= 0.051
    assert distance_to_line(robot.trail, (0, 0), goal) <= 0.05
    assert max(math.hypot(x, y) for x, y in robot.trail) <= math.hypot(*goal) + 0.05  # no overshoot


def test_three_metres_cost_little_more_than_full_speed():
    frames = drive(Unicycle(), Driver(), [(3.0, 0.0)])
    assert frames <= math.ceil(3.0 / 0.5 / PERIOD) + 4


def test_sharp_corners_are_not_cut():
    robot, points = Unicycle(), [(1.5, 0.0), (1.5, 1.5), (0.5, 2.0)]
    drive(robot, Driver(), points)
    legs = list(zip([(0.0, 0.0), *points[:-1]], points, strict=True))

    def off_track(xy):
        best = math.inf
        for (ax, ay), (bx, by) in legs:
            t = ((xy[0] - ax) * (bx - ax) + (xy[1] - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
            t = min(max(t, 0.0), 1.0)
            best = min(best, math.dist(xy, (ax + t * (bx - ax), ay + t * (by - ay))))
        return best

    assert max(map(off_track, robot.trail)) <= 0.05


def test_points_on_a_line_are_passed_without_stopping():
    points = [(0.5 * n, 0.02 * (n % 2)) for n in range(1, 9)]
    passing = drive(Unicycle(), Driver(), points)
    stopping, robot, driver = 0, Unicycle(), Driver()
    for point in points:
        stopping += drive(robot, driver, [point])
    assert passing <= math.ceil(4.0 / 0.5 / PERIOD) + 5
    assert stopping > 1.2 * passing


def test_a_point_behind_the_robot_was_not_passed():
    robot, driver = Unicycle(heading=math.pi), Driver()
    command = driver.drive_to(robot.frame(), (1.0, 0.02), 0.0, then=(2.0, 0.02))
    assert command is not None
    assert (command.linear, abs(command.angular) > 0.3) == (0.0, True)


def test_same_frames_same_commands():
    trails = []
    for _ in range(2):
        robot = Unicycle(heading=0.3)
        drive(robot, Driver(), [(1.0, -1.0), (2.0, 0.0)])
        trails.append(robot.trail)
    assert trails[0] == trails[1]


def test_asking_twice_for_one_frame_changes_nothing():
    once, twice = Driver(), Driver()
    robot = Unicycle()
    for _ in range(6):
        frame = robot.frame()
        twice.stop(frame, 0.0)
        command = once.drive_to(frame, (2.0, 0.4), 0.0)
        assert twice.drive_to(frame, (2.0, 0.4), 0.0) == command
        assert command is not None
        robot.step(command)


def test_speeds_keep_the_limits():
    robot, driver = Unicycle(), Driver(linear_speed=0.3, angular_speed=0.8)
    for point in [(1.0, 1.0), (-1.0, 0.0)]:
        while (command := driver.drive_to(robot.frame(), point, 0.0)) is not None:
            assert abs(command.linear) <= 0.3
            assert abs(command.angular) <= 0.8
            robot.step(command)


@pytest.mark.parametrize(
    "bad", [{"linear_speed": 0.0}, {"rate_hz": -5.0}, {"angular_acceleration": math.nan}]
)
def test_impossible_limits_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        Driver(**bad)
