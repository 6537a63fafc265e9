"""Pure driving law: a frame's pose and a goal -> a command. No plug-in, no simulator, no map.

The law is near time-optimal at a low frame rate. Between two frames the robot carries out one command
blindly, so each command is the fastest one from which it can still come to rest at the goal: with the
speed at the end of the last period v0, limit of acceleration a and period T, a command v1 followed by
full braking ends at

    S(v1) = v1 T + (v0 - v1) |v0 - v1| / 2a + v1 |v1| / 2a

which grows with v1 over the speeds that one period can reach, so the largest v1 with S(v1) <= goal is found
by bisection. How far the robot lagged behind the last command says how hard it really accelerates; one that
follows at once is treated as such (ALGORITHM E: turn by the heading difference, drive, correct).
"""

from __future__ import annotations

import math

from dssmsg.frame import FloatArray, Frame
from dssmsg.interfaces.source import Command

TILT_RANGE_RAD = (-1.4, 1.75)
PAN_RANGE_RAD = (-2.6, 2.6)
_HEADING_TOLERANCE_RAD = math.radians(1.0)
_TURN_FIRST_RAD = 0.25  # a larger heading error is turned away on the spot
_TURN_ENOUGH_RAD = 0.06  # a turn on the spot ends here and steering takes over
_CORNER_STOP_RAD = math.radians(25.0)  # a sharper corner of a path is not rounded but stopped at
_AIM_AHEAD_M = 0.3  # nearer goals are steered at as if they were this far, else the bearing swings


def wrap_angle(angle_rad: float) -> float:
    """The same direction in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def base_heading(world_from_base: FloatArray) -> float:
    """Heading of the base's x axis on the floor, radians counter-clockwise from world x."""
    return math.atan2(world_from_base[1, 0], world_from_base[0, 0])


class _Axis:
    """One degree of freedom (metres or radians): its speed as far as commands tell, and the next command."""

    def __init__(self, top_speed: float, acceleration: float, period_secs: float) -> None:
        self.top_speed = top_speed
        self.speed = 0.0
        self.calm_speed = acceleration * period_secs / 2
        self._nominal = acceleration
        self._acceleration = acceleration
        self._period = period_secs
        self._command: float | None = None

    @property
    def longest_step(self) -> float:
        """The furthest way of one period."""
        return self.top_speed * self._period

    def rest(self) -> None:
        """The robot stands."""
        self.speed, self._command = 0.0, None

    def advance(self, moved: float) -> None:
        """A period is over in which the robot moved by `moved`; without a command it has come to rest."""
        command, self._command = self._command, None
        if command is None:
            self.speed = 0.0
            return
        change = command - self.speed
        ramp = min(abs(change), self._step(self._nominal))
        lag_expected = (abs(change) - ramp) * self._period + ramp * ramp / (2 * self._nominal)
        if lag_expected > 0.05 * self.top_speed * self._period:
            lag = (command * self._period - moved) * math.copysign(1.0, change) / lag_expected
            self._acceleration = self._nominal / min(max(lag, 0.02), 1.0)
        self.speed = self._reach(command)

    def issue(self, command: float) -> float:
        """Note that `command` is given for the next period."""
        self._command = command
        return command

    def braking(self, speed: float | None = None) -> float:
        """Signed way to rest at full braking from `speed` (default: the present one)."""
        speed = self.speed if speed is None else speed
        return speed * abs(speed) / (2 * self._acceleration)

    def fastest(self, distance: float, top_speed: float | None = None) -> float:
        """The fastest command from which the robot still comes to rest at `distance` (signed)."""
        sign = math.copysign(1.0, distance)
        limit = self.top_speed if top_speed is None else min(top_speed, self.top_speed)
        low, high = sorted((sign * self._reach(-sign * limit), sign * self._reach(sign * limit)))
        if self._way(sign * high) * sign <= abs(distance):
            return sign * high
        for _ in range(40):
            middle = (low + high) / 2
            if self._way(sign * middle) * sign <= abs(distance):
                low = middle
            else:
                high = middle
        return sign * low

    def expect(self, command: float) -> float:
        """How far the robot will move in a period of `command`."""
        change = command - self.speed
        ramp = min(abs(change), self._step(self._acceleration))
        lag = (abs(change) - ramp) * self._period + ramp * ramp / (2 * self._acceleration)
        return command * self._period - math.copysign(lag, change)

    def _way(self, command: float) -> float:
        return self.expect(command) + self.braking(command)

    def _step(self, acceleration: float) -> float:
        return acceleration * self._period

    def _reach(self, command: float) -> float:
        step = self._step(self._acceleration)
        return min(max(command, self.speed - step), self.speed + step)


class Driver:
    """Drives to points and turns to headings, one command a frame.

    It remembers the last frame and command, from which it knows how fast the robot is; a frame that does not
    follow the last one (index, visit) is taken as one at rest.
    Speeds m/s and rad/s, accelerations m/s2 and rad/s2.
    """

    def __init__(
        self,
        linear_speed: float = 0.5,
        angular_speed: float = 1.2,
        rate_hz: float = 5.0,
        *,
        linear_acceleration: float = 1.0,
        angular_acceleration: float = 3.0,
    ) -> None:
        for name, value in (
            ("linear_speed", linear_speed),
            ("angular_speed", angular_speed),
            ("rate_hz", rate_hz),
            ("linear_acceleration", linear_acceleration),
            ("angular_acceleration", angular_acceleration),
        ):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}: expected a number above 0, got {value}")
        self._linear = _Axis(linear_speed, linear_acceleration, 1 / rate_hz)
        self._angular = _Axis(angular_speed, angular_acceleration, 1 / rate_hz)
        self._frame: Frame | None = None
        self._tilt: tuple[float, float] | None = None  # as commanded last, and as it was then
        self._pan = 0.0  # as commanded last
        self._turning = False

    def drive_to(
        self,
        frame: Frame,
        xy: tuple[float, float],
        tilt: float,
        *,
        then: tuple[float, float] | None = None,
        tolerance: float = 0.05,
    ) -> Command | None:
        """The next command on the straight way to `xy` (world metres), or None: arrived and (nearly) at rest.

        `tilt` is the camera's tilt on the way. `then` is the point that comes after: a flat corner is passed
        without stopping (None is then returned while moving), at a sharp one the robot stops. At most
        `tolerance` metres are left over at the end.
        """
        self._take(frame)
        base = frame.world_from_base
        heading = base_heading(base)
        dx, dy = xy[0] - float(base[0, 3]), xy[1] - float(base[1, 3])
        passing = then is not None and self._is_flat(dx, dy, xy, then, heading)
        along = dx * math.cos(heading) + dy * math.sin(heading)
        lateral = dy * math.cos(heading) - dx * math.sin(heading)
        at_rest = math.hypot(along - self._linear.braking(), lateral) <= tolerance
        if at_rest and abs(self._linear.speed) <= self._linear.calm_speed:
            self._turning = False
            return None
        # What lies further back than one period's way was not passed: the robot faces away from it.
        just_passed = -self._linear.longest_step - tolerance <= along <= tolerance
        if passing and just_passed and abs(lateral) <= 2 * tolerance:
            return None
        error = wrap_angle(math.atan2(dy, dx) - heading)
        at_rest_error = wrap_angle(error - self._angular.braking())
        self._turning = abs(at_rest_error) > (_TURN_ENOUGH_RAD if self._turning else _TURN_FIRST_RAD)
        straight_is_enough = along > 0 and abs(lateral) < 0.8 * tolerance
        if self._turning and not straight_is_enough:
            return self._issue(frame, 0.0, self._angular.fastest(error), tilt)
        self._turning = False
        steer = math.atan2(lateral, max(along, _AIM_AHEAD_M))
        room = along + (math.dist(xy, then) if passing and then is not None else 0.0)
        top_speed = self._linear.top_speed * max(0.2, 1.0 - 2.0 * abs(steer))
        return self._issue(
            frame,
            max(0.0, self._linear.fastest(max(0.0, room), top_speed)),
            self._angular.fastest(steer),
            tilt,
        )

    def look(self, frame: Frame, heading: float, tilt: float) -> Command | None:
        """Turn the base on the spot until the camera looks along `heading` (radians, world) with `tilt`.

        None once the heading is within 1 degree, the tilt is reached (or does not get any nearer: a mount
        has limits) and the robot is at rest.
        """
        self._take(frame)
        self._turning = False
        panned = self._pan != 0.0  # the mount is on its way back to straight ahead, where look() wants it
        error = wrap_angle(heading - (base_heading(frame.world_from_base) if panned else frame.heading_rad))
        at_rest_error = wrap_angle(error - self._angular.braking())
        calm = abs(self._angular.speed) <= self._angular.calm_speed and abs(error) <= _HEADING_TOLERANCE_RAD
        if calm and abs(at_rest_error) <= _HEADING_TOLERANCE_RAD and self._tilt_reached(frame, tilt):
            return None
        return self._issue(frame, 0.0, self._angular.fastest(error), tilt)

    def gaze(self, frame: Frame, heading: float, tilt: float) -> Command:
        """Look along `heading` (radians, world) as soon as can be: the base turns, the mount pans the rest.

        Unlike `look` it always gives a command; whoever asks sees from the frame whether the gaze is there.
        """
        self._take(frame)
        self._turning = False
        error = wrap_angle(heading - base_heading(frame.world_from_base))
        angular = self._angular.fastest(error)
        pan = wrap_angle(error - self._angular.expect(angular))
        return self._issue(frame, 0.0, angular, tilt, min(max(pan, PAN_RANGE_RAD[0]), PAN_RANGE_RAD[1]))

    def stop(self, frame: Frame, tilt: float) -> Command:
        """Stand still, looking at `tilt`."""
        self._take(frame)
        self._turning = False
        return self._issue(frame, 0.0, 0.0, tilt)

    def _take(self, frame: Frame) -> None:
        """Learn from the newest frame how fast the robot is; the same frame again changes nothing."""
        last, self._frame = self._frame, frame
        if last is not None and (last.visit, last.index) == (frame.visit, frame.index):
            return
        if last is None or (last.visit, last.index + 1) != (frame.visit, frame.index):
            self._linear.rest()
            self._angular.rest()
            self._tilt, self._pan, self._turning = None, 0.0, False
            return
        before, after = last.world_from_base, frame.world_from_base
        turned = wrap_angle(base_heading(after) - base_heading(before))
        middle = base_heading(before) + turned / 2
        shift = after[:2, 3] - before[:2, 3]
        self._linear.advance(float(shift[0]) * math.cos(middle) + float(shift[1]) * math.sin(middle))
        self._angular.advance(turned)

    def _issue(self, frame: Frame, linear: float, angular: float, tilt: float, pan: float = 0.0) -> Command:
        tilt = min(max(tilt, TILT_RANGE_RAD[0]), TILT_RANGE_RAD[1])
        self._tilt = (tilt, frame.tilt_rad)
        self._pan = pan
        return Command(self._linear.issue(linear), self._angular.issue(angular), pan, tilt)

    def _tilt_reached(self, frame: Frame, tilt: float) -> bool:
        tilt = min(max(tilt, TILT_RANGE_RAD[0]), TILT_RANGE_RAD[1])
        if abs(frame.tilt_rad - tilt) <= _HEADING_TOLERANCE_RAD:
            return True
        if self._tilt is None:
            return False
        wanted, before = self._tilt
        return wanted == tilt and abs(frame.tilt_rad - before) < math.radians(0.1)

    @staticmethod
    def _is_flat(
        dx: float, dy: float, xy: tuple[float, float], then: tuple[float, float], heading: float
    ) -> bool:
        """Whether the way bends so little at `xy` that it may be passed at speed."""
        incoming = math.atan2(dy, dx) if math.hypot(dx, dy) > _AIM_AHEAD_M else heading
        outgoing = math.atan2(then[1] - xy[1], then[0] - xy[0])
        return abs(wrap_angle(outgoing - incoming)) <= _CORNER_STOP_RAD
