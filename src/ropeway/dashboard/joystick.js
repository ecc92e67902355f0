// Tells the page ten times a second where the joystick is while it is held, and once when it is let go.
(() => {
  const start = (pad) => {
    const knob = pad.querySelector(".knob");
    let position = null;
    let clock = 0;
    const tell = () => emitEvent("drive", position ? { held: true, ...position } : { held: false });
    const move = (event) => {
      const box = pad.getBoundingClientRect();
      const reach = box.width * 0.33;
      let x = (event.clientX - box.left - box.width / 2) / reach;
      let y = (box.top + box.height / 2 - event.clientY) / reach;
      const far = Math.max(Math.hypot(x, y), 1);
      position = { x: x / far, y: y / far };
      knob.style.transform = `translate(${position.x * reach}px, ${-position.y * reach}px)`;
    };
    const release = () => {
      if (!position) return;
      clearInterval(clock);
      position = null;
      knob.style.transform = "";
      tell();
    };
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      clearInterval(clock);
      move(event);
      tell();
      clock = setInterval(tell, 100);
    });
    pad.addEventListener("pointermove", (event) => position && move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) pad.addEventListener(end, release);
    window.addEventListener("blur", release);
    document.addEventListener("visibilitychange", () => document.hidden && release());
  };
  const wait = () => {
    const pad = document.querySelector(".joystick");
    if (pad) start(pad);
    else setTimeout(wait, 50);
  };
  wait();
})();
