"use strict";
/* What can be done with the picture: pictures and films as files, distances between points. */

/** Offers a file to be saved. */
function offer(blob, name) {
  const link = Object.assign(make("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** A film of the picture: `start()`, and `stop()`, which promises the film (WebM, or MP4 where there is no WebM). */
function filmOf(world) {
  const kind = ["video/webm", "video/mp4"].find((one) => window.MediaRecorder && MediaRecorder.isTypeSupported(one));
  let recorder = null, parts = [];
  return {
    kind,
    running: () => recorder !== null,
    start() {
      const canvas = make("canvas");
      parts = [];
      world.compose(canvas);
      recorder = new MediaRecorder(canvas.captureStream(30), { mimeType: kind, videoBitsPerSecond: 8e6 });
      recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
      recorder.start();
      (function frame() {
        if (!recorder || recorder.state !== "recording") return;
        world.compose(canvas);
        requestAnimationFrame(frame);
      })();
    },
    stop: () => new Promise((done) => {
      recorder.addEventListener("stop", () => {
        recorder = null;
        done(new Blob(parts, { type: kind }));
      });
      recorder.stop();
    }),
  };
}

/** The buttons over the picture. */
function toolBar(world, name) {
  const bar = find("tools"), said = find("said"), film = filmOf(world);
  const button = (text, title, act) => {
    const made = Object.assign(make("button", text), { type: "button", title });
    made.setAttribute("aria-label", title);
    made.addEventListener("click", () => act(made));
    bar.append(made);
    return made;
  };
  [["iso", 0.9, 0.35, "look from the side and above"], ["x", 0, 0, "look along x"], ["y", Math.PI / 2, 0, "look along y"], ["top", -Math.PI / 2, 1.5, "look from above"]].forEach(([text, azimuth, height, title]) => {
    button(text, title, () => { world.view.look(azimuth, height); world.fit(); });
  });
  button("measure", "distance between two points: click on both", (made) => {
    const on = made.getAttribute("aria-pressed") !== "true";
    made.setAttribute("aria-pressed", on);
    world.measure(on, (text) => { said.textContent = text; });
    said.textContent = on ? "Click on two points of the drawing." : "";
  }).setAttribute("aria-pressed", "false");
  button("png", "save the picture (PNG)", () => {
    const canvas = make("canvas");
    world.compose(canvas);
    canvas.toBlob((blob) => offer(blob, `${name}.png`));
  });
  if (film.kind) {
    button("film", "record a film; a second click saves it", async (made) => {
      made.setAttribute("aria-pressed", !film.running());
      if (!film.running()) film.start();
      else offer(await film.stop(), `${name}.${film.kind.slice(6)}`);
    }).setAttribute("aria-pressed", "false");
  }
  roving(bar, "button", "ArrowLeft", "ArrowRight");
}
