// What the pages of a `PageServer` share.
"use strict";
const part = id => document.getElementById(id);
const stream = new WebSocket(`ws://${location.host}/stream`);
stream.binaryType = "blob";
const tell = told => { if (stream.readyState === WebSocket.OPEN) stream.send(JSON.stringify(told)); };

// Shows in an element what comes, and calls `about` with what is told beside each image.
function follow(image, about, ended) {
  let drawn = "";
  stream.onmessage = ({ data }) => {
    if (!(data instanceof Blob)) { about(JSON.parse(data)); return; }
    if (!data.size) return;
    URL.revokeObjectURL(drawn);
    image.src = drawn = URL.createObjectURL(data);
  };
  stream.onclose = ({ code, reason }) => ended(code >= 4000 ? reason : "ended");
}

const WHEELS = {  // What keys ask of a rover's wheels: ahead, and to the left.
  ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 0.6], ArrowRight: [0, -0.6],
  KeyW: [1, 0], KeyS: [-1, 0], KeyA: [0, 0.6], KeyD: [0, -0.6],
};
const held = new Set();  // Keys that are held, by their places on the keyboard, or by buttons for them.

const heldWheels = () => [0, 1].map(
  axis => [...held].reduce((sum, key) => sum + (WHEELS[key] || [0, 0])[axis], 0));

// Puts buttons in an element that are held as the arrow keys are.
function addPad(element) {
  element.className = "pad";
  element.innerHTML = "<span></span><button data-hold='ArrowUp' aria-label='ahead'>▲</button>" +
    "<span></span><button data-hold='ArrowLeft' aria-label='left'>◀</button>" +
    "<button data-hold='ArrowDown' aria-label='back'>▼</button>" +
    "<button data-hold='ArrowRight' aria-label='right'>▶</button>";
}

// Tells what `wanted` returns, by name, when keys change and every 50 ms as long as any of its
// numbers is not 0: who no longer hears it stops.
function tellWhileHeld(keys, wanted) {
  let acting = false;
  const act = () => {
    const told = wanted(), active = Object.values(told).flat().some(Boolean);
    if (active || acting) tell(told);
    acting = active;
  };
  const letGo = () => { held.clear(); act(); };
  addEventListener("keydown", event => {
    if (!keys.includes(event.code) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    if (event.repeat) return;  // A key that was let go with the focus has to be pressed anew.
    held.add(event.code);
    act();
  });
  addEventListener("keyup", event => { if (held.delete(event.code)) act(); });
  for (const button of document.querySelectorAll("[data-hold]")) {
    const release = () => { if (held.delete(button.dataset.hold)) act(); };
    button.onpointerdown = event => {
      button.setPointerCapture(event.pointerId);
      held.add(button.dataset.hold);
      act();
    };
    button.onpointerup = button.onpointercancel = button.onlostpointercapture = release;
    button.oncontextmenu = event => event.preventDefault();  // Of a touch that lasts.
  }
  addEventListener("blur", letGo);
  addEventListener("pagehide", letGo);
  document.addEventListener("visibilitychange", letGo);
  setInterval(act, 50);
}
