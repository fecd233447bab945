// One pointer or two, and the wheel, over a picture: what they do there is the caller's.
const DOUBLE_TAP_MS = 350;
const STILL_PX = 12;
const WHEEL_STEP = 60; // a notch of a wheel is 100 or more, a trackpad's steps are small

const between = (first, second) => Math.hypot(first.clientX - second.clientX, first.clientY - second.clientY);

function pairOf(pointers) {
  const [first, second] = [...pointers.values()];
  const middle = { clientX: (first.clientX + second.clientX) / 2, clientY: (first.clientY + second.clientY) / 2 };
  return { middle, apart: Math.max(between(first, second), 1) };
}

// on: point(event), leave(), begin(event), drag(event), end(), pinch(before, now), twice(), turn(step), zoom(event, factor)
export function gestures(surface, on) {
  const pointers = new Map();
  let [first, pinched, tapped, turned] = [null, null, null, 0];

  // Two fingers are for the picture, not for the page.
  surface.addEventListener("touchstart", (event) => event.touches.length > 1 && event.preventDefault(), { passive: false });
  surface.addEventListener("pointerdown", (event) => {
    if (event.button > 1 || event.target.closest("button")) {
      return;
    }
    surface.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    if (pointers.size === 1) {
      [first, pinched] = [event, null];
      on.point(event);
      on.begin(event);
    } else if (pointers.size === 2) {
      on.end();
      pinched = pairOf(pointers);
    }
  });
  surface.addEventListener("pointermove", (event) => {
    if (pointers.has(event.pointerId)) {
      pointers.set(event.pointerId, event);
    }
    if (pointers.size > 1) {
      const now = pairOf(pointers);
      on.pinch(pinched, now);
      pinched = now;
      return;
    }
    on.point(event);
    if (pointers.size === 1 && !pinched) {
      on.drag(event);
    }
  });
  for (const end of ["pointerup", "pointercancel"]) {
    surface.addEventListener(end, (event) => {
      if (!pointers.delete(event.pointerId) || pointers.size > 0 || pinched) {
        return;
      }
      on.end();
      const still = end === "pointerup" && between(first, event) < STILL_PX;
      const again = still && tapped && event.timeStamp - tapped.timeStamp < DOUBLE_TAP_MS && between(tapped, event) < 2 * STILL_PX;
      if (again) {
        on.twice();
      }
      tapped = still && !again ? event : null;
    });
  }
  surface.addEventListener("pointerleave", () => on.leave());
  surface.addEventListener("wheel", (event) => {
    event.preventDefault();
    if (event.ctrlKey) { // a pinch on a trackpad too
      on.zoom(event, 2 ** (event.deltaY / 200));
      return;
    }
    turned += event.deltaY;
    if (Math.abs(turned) >= WHEEL_STEP) {
      on.turn(Math.sign(turned));
      turned = 0;
    }
  }, { passive: false });
}
