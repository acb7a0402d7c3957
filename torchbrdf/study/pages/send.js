// Talk to the server until it answers: what a person did is never lost to a bad connection.
const trouble = document.getElementById("trouble");
const TIMEOUT = 10000;
const LONGEST = 30000;  // milliseconds to wait, whatever a server says

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
    let what = "The server cannot be reached", least = 0;
    try {
      const answer = await fetch(path, { ...options, signal: AbortSignal.timeout(TIMEOUT) });
      if (answer.status < 500 && answer.status !== 429) {
        const said = await answer.json();
        say("");
        return { status: answer.status, ...said };
      }
      what = answer.status === 429 ? "Many people begin just now" : "The server is busy";
      least = 1000 * answer.headers.get("Retry-After") || 0;
    } catch {
      // Not reachable, or cut off in the middle.
    }
    say(`${what}. Nothing is lost; trying again …`);
    await wait(Math.max(pause, Math.min(least, LONGEST)));
  }
}
