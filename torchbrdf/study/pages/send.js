// Talk to the server until it answers: what a person did is never lost to a bad connection.
const trouble = document.getElementById("trouble");
const TIMEOUT = 10000;

export const wait = milliseconds => new Promise(done => setTimeout(done, milliseconds));

export function say(text) {
  trouble.textContent = text;
  trouble.hidden = !text;
}

// Posts the body as JSON, or gets where there is none; gives { status, ...what the server said }.
export async function send(path, body) {
  const options = { cache: "no-store", redirect: "error" };
  if (body !== undefined) {
    Object.assign(options, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  }
  for (let pause = 500; ; pause = Math.min(2 * pause, 4000)) {
    try {
      const answer = await fetch(path, { ...options, signal: AbortSignal.timeout(TIMEOUT) });
      if (answer.status < 500) {
        const said = await answer.json();
        say("");
        return { status: answer.status, ...said };
      }
    } catch {
      // Not reachable, or cut off in the middle.
    }
    say("The server cannot be reached. Nothing is lost; trying again …");
    await wait(pause);
  }
}
