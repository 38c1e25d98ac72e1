// One drive of a simulated rover on a course: the rules of sim/world/rover.py and episode.py, with less detail.
const SUBSTEP_S = 0.01, SUBSTEPS = 10, TICK_S = 0.1, HEADING_NOISE = 1.75; // rad for each m of noise

const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
const toward = (speed, target, rise, fall) => {
  const step = (speed * (target - speed) >= 0 ? rise : fall) * SUBSTEP_S;
  return clamp(target, speed - step, speed + step);
};

// A number of the standard normal distribution.
const normal = () => Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());

// Points of a body's own frame in the frame of its pose.
function placed(points, { x, y, theta }) {
  const c = Math.cos(theta), s = Math.sin(theta);
  return points.map(([a, b]) => [x + c * a - s * b, y + s * a + c * b]);
}

// Whether no side of the first rectangle separates it from the second.
function reaches(corners, others) {
  return [0, 1].every((side) => {
    const [ax, ay] = corners[side], [bx, by] = corners[side + 1];
    const along = ([x, y]) => x * (bx - ax) + y * (by - ay);
    const own = corners.map(along), theirs = others.map(along);
    return Math.max(...own) >= Math.min(...theirs) && Math.max(...theirs) >= Math.min(...own);
  });
}

class Drive {
  // The settings may change during the drive: delay in s, gain and slip as shares, noise in m.
  constructor(core, course, rover, settings) {
    Object.assign(this, { core, course, rover, settings, substep: 0, v: 0, omega: 0, holds: false, failure: "" });
    this.pose = { x: 0, y: 0, theta: 0 };
    this.poses = []; // at the end of each tick, after the start
    this.potentials = []; // of each tick
    this.sent = []; // [substep, v, omega]
    this.over = false;
    core.reset();
  }

  get time() {
    return this.substep * SUBSTEP_S;
  }

  // The pose of the moving reference, and its speeds.
  get dot() {
    return this.course.ticks[Math.floor(this.substep / SUBSTEPS)];
  }

  push(dx, dy) {
    if (this.over) return;
    this.pose = { ...this.pose, x: this.pose.x + dx, y: this.pose.y + dy };
    this.checkContact();
  }

  // What a camera would measure.
  see() {
    const { noise } = this.settings, { x, y, theta } = this.pose;
    return { x: x + noise * normal(), y: y + noise * normal(), theta: wrapped(theta + HEADING_NOISE * noise * normal()) };
  }

  // The signals of rover_ncp/course/signals.py that the policy observes.
  observe(seen, tick, start) {
    const [x, y, theta, v, omega] = this.course.ticks[tick];
    const dx = x - seen.x, dy = y - seen.y, c = Math.cos(seen.theta), s = Math.sin(seen.theta);
    const all = [seen.x, seen.y, seen.theta, start, c * dx + s * dy, c * dy - s * dx, wrapped(theta - seen.theta), v, omega];
    return this.core.data.inputs.map((signal) => all[signal]);
  }

  think() {
    const tick = this.substep / SUBSTEPS, seen = this.see(), { start, hold } = this.course;
    if (tick === 0) {
      this.core.tick(this.observe(seen, 0, 0)); // a warm-up, in which the rover stands
      this.poses.push(this.pose);
    }
    let [v, omega] = this.core.tick(this.observe(seen, tick, this.time >= start - 1e-9 ? 1 : 0));
    if (this.time > hold) {
      const { near } = this.errors(seen), small = Math.abs(v) < this.rover.hold_v && Math.abs(omega) < this.rover.hold_omega;
      this.holds = near && (this.holds || small);
    }
    if (this.holds) v = omega = 0;
    this.sent.push([this.substep, v, omega]);
    this.potentials.push([...this.core.potentials]);
  }

  // Advance by 0.01 s; every tenth time the circuit decides before.
  step() {
    if (this.over) return;
    if (this.substep % SUBSTEPS === 0) this.think();
    const { delay, gain, slip } = this.settings, { accel, decel, alpha, alpha_decel, v_max, omega_max } = this.rover;
    const late = this.substep - Math.round(delay / SUBSTEP_S);
    const [, v, omega] = this.sent.findLast(([since]) => since <= late) || [0, 0, 0];
    this.v = toward(this.v, clamp(gain * v, -v_max, v_max), accel, decel);
    this.omega = toward(this.omega, clamp(gain * (1 - slip) * omega, -omega_max, omega_max), alpha, alpha_decel);
    const { x, y, theta } = this.pose, way = this.v * SUBSTEP_S;
    this.pose = { x: x + way * Math.cos(theta), y: y + way * Math.sin(theta), theta: theta + this.omega * SUBSTEP_S };
    this.substep += 1;
    this.checkContact();
    if (this.substep % SUBSTEPS) return;
    this.poses.push(this.pose);
    if (this.substep >= SUBSTEPS * (this.course.ticks.length - 1)) this.over = true;
  }

  checkContact() {
    const outline = placed(this.course.outline, this.pose);
    if (!this.course.obstacles.some((corners) => reaches(outline, corners) && reaches(corners, outline))) return;
    this.failure = "touched a car";
    this.over = true;
  }

  errors(pose) {
    const [x, y, theta] = this.course.target, { position_m, heading_rad } = this.course.parked;
    const far = Math.hypot(pose.x - x, pose.y - y), turned = Math.abs(wrapped(pose.theta - theta));
    return { far, turned, near: far <= position_m && turned <= heading_rad };
  }

  // Whether the rover parked, and why not, by its true pose.
  verdict() {
    const { far, turned } = this.errors(this.pose), { position_m, heading_rad, still_s, still_m, still_rad } = this.course.parked;
    const last = this.poses.slice(-Math.round(still_s / TICK_S) - 1);
    const moved = Math.max(...last.map(({ x, y }) => Math.hypot(x - this.pose.x, y - this.pose.y)));
    const swung = Math.max(...last.map(({ theta }) => Math.abs(wrapped(theta - this.pose.theta))));
    const cm = (m) => (m < 1 ? `${number(100 * m, 1)} cm` : `${number(m, 2)} m`), degrees = (rad) => `${number((180 * rad) / Math.PI, 1)}°`;
    let reason = this.failure;
    if (!reason && far > position_m) reason = `${cm(far)} from the goal, at most ${cm(position_m)}`;
    if (!reason && turned > heading_rad) reason = `turned by ${degrees(turned)}, at most ${degrees(heading_rad)}`;
    if (!reason && !(moved < still_m && swung < still_rad)) reason = `still moving: ${cm(moved)} and ${degrees(swung)} in the last ${still_s} s`;
    return { parked: !reason, far, turned, words: reason || `${cm(far)} and ${degrees(turned)} from the goal` };
  }
}
