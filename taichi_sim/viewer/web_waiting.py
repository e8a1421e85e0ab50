"""The first page that a browser gets, which waits for that of viser, opens it in its own place, and mends what it lacks."""

__all__ = ["ENDED", "PAGE", "PHONE", "WAITING"]

ENDED = "The simulation ended"  # the heading of the last words to pages
PAGE = "?page"  # what viser's page is asked for by, from the one below
PHONE = 576  # px: viser puts the panel below the scene on pages that are not wider
# Small, so that it comes at once: while kernels are compiled, other threads get no time for up to half a minute. Its script asks
# for viser's page until it comes, and mends that page:
# - viser connects again only while the page has the focus, which one behind a terminal or in a notebook has not;
# - viser, which connects in a worker, breaks off each attempt to connect again after 1 s, the worker by itself after 5 s;
# - viser tries for ever when the program has gone; nothing comes any more after the last words;
# - viser tells the size of the page in pixels of the screen, of which a fine one has several for each of the page;
# - viser begins with the panel unfolded on a phone, where it covers the scene;
# - viser is light where all else is dark.
WAITING = f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>taichi_sim</title><link rel="icon" href="data:,">
<meta name="viewport" content="width=device-width, initial-scale=1"><meta name="color-scheme" content="light dark">
<div id="waiting" style="position: fixed; z-index: 9; left: 0; right: 0; top: 40%; text-align: center; font: 1.2rem sans-serif">
taichi_sim is compiling its kernels, or reading the scene.<br>The scene will appear here by itself.</div>
<script>
const waiting = document.getElementById("waiting"), workers = [], Plain = window.Worker;
document.hasFocus = () => true;
window.Worker = class extends Plain {{
  constructor(...all) {{
    super(...all);
    workers.push(this);
    this.addEventListener("message", event => {{ if (event.data?.type === "closed") this.busy = false; }});
  }}
  postMessage(told, ...rest) {{
    if (told?.type === "retry") {{
      if (this.busy) return;
      this.busy = true;
    }}
    const page = {{ image_width: innerWidth, image_height: innerHeight }};
    if (told?.message?.type === "ViewerCameraMessage") Object.assign(told.message, page);
    super.postMessage(told, ...rest);
  }}
}};
const dark = new URLSearchParams(location.search);
dark.delete("darkMode");
if (matchMedia("(prefers-color-scheme: dark)").matches) dark.set("darkMode", "");
history.replaceState(null, "", "?" + dark);
const ask = () => fetch("{PAGE}").then(answer => answer.ok ? answer.text() : Promise.reject())
  .catch(() => new Promise(again => setTimeout(again, 1000)).then(ask));
ask().then(page => {{
  document.open(); document.write(page); document.close();
  document.body.append(waiting);
  new MutationObserver((_, watch) => {{
    if (!document.body.textContent.includes("{ENDED}")) return;
    watch.disconnect(); workers.forEach(one => one.terminate());
  }}).observe(document.body, {{ childList: true, subtree: true }});
  const timer = setInterval(() => {{
    const figures = document.querySelector(".figures"), waits = document.body.textContent.includes("Please wait:");
    if (figures || waits) waiting.remove();
    if (!figures || waits) return;
    clearInterval(timer);
    let panel = innerWidth > {PHONE} ? null : figures;
    while (panel && getComputedStyle(panel).position !== "fixed") panel = panel.parentElement;
    if (figures.getClientRects().length) panel?.querySelector("[style*='cursor: pointer']")?.click();
  }}, 100);
}});
</script></html>
"""
