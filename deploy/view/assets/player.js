// The time slider, play and pause. Calls `onTime` when the time changes.
class Player {
  constructor(model, onTime) {
    this.model = model;
    this.onTime = onTime;
    this.t = 0;
    this.playing = false;
    this.waiting = false;
    this.slider = $("time");
    this.slider.addEventListener("input", () => {
      this.pause();
      this.set(Number(this.slider.value));
    });
    $("play").addEventListener("click", () => (this.playing ? this.pause() : this.play()));
    document.addEventListener("keydown", (event) => this.key(event));
    this.stretch();
  }

  // The drive may have become longer.
  stretch() {
    this.slider.max = String(Math.round(10 * this.model.end) / 10);
  }

  set(t) {
    this.t = clamp(t, 0, this.model.end);
    if (this.waiting) return;
    this.waiting = true; // however often the slider moves, the page is drawn once a frame
    requestAnimationFrame(() => {
      this.waiting = false;
      this.slider.value = String(this.t);
      $("clock").textContent = `${number(this.t, 1)} s`;
      this.onTime(this.t);
    });
  }

  play() {
    if (this.t >= this.model.end - 0.05) this.t = 0;
    this.playing = true;
    this.show();
    let last = performance.now();
    const step = (now) => {
      if (!this.playing) return;
      this.set(this.t + ((now - last) / 1000) * Number($("speed").value));
      last = now;
      if (this.t >= this.model.end) this.pause();
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  pause() {
    this.playing = false;
    this.show();
  }

  show() {
    $("play").textContent = this.playing ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", String(this.playing));
  }

  // Space plays, arrows step a tick: wherever the focus is, unless what has it needs these keys itself.
  key(event) {
    const own = event.target.closest("input, select, button, a, summary, [role=button]");
    if (own || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = { ArrowRight: 0.1, ArrowLeft: -0.1, PageUp: 1, PageDown: -1 }[event.key];
    if (event.key === " ") (this.playing ? this.pause() : this.play());
    else if (step && event.key.startsWith("Arrow")) {
      this.pause();
      this.set(this.t + step);
    } else return;
    event.preventDefault();
  }
}
