"""What a browser must find in a report."""

from tests.experiments.browser import Browser

LEAST_WIDTH = 100  # [px] of a picture that is there
_STICKING_OUT = (
    "[...document.body.querySelectorAll('*')].filter(each => !each.closest('.scroll')"
    " && each.getBoundingClientRect().right > innerWidth + 1).length"
)
_DANGLING = (
    "[...document.querySelectorAll('a')].map(link => decodeURIComponent(link.hash))"
    ".filter(hash => !document.getElementById(hash.slice(1)))"
)
_HIDDEN = (
    "[...document.querySelectorAll('details:not(.extra) table')].filter(each =>"
    " !each.checkVisibility({contentVisibilityAuto: true})).length"
)
_TOLD = ("Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown")


def sound_pictures(path, width, profile):
    """Show a report, find nothing broken and nothing outside, and return how many pictures it has.

    Args:
        path: Path of the page.
        width: Width of the window [px].
        profile: Empty folder for the browser.
    """
    with Browser(profile) as chromium:
        chromium.show(path.as_uri(), width)
        # Fails for a picture that is broken.
        chromium.evaluate("Promise.all([...document.images].map(image => image.decode()))")
        sizes = chromium.evaluate("[...document.images].map(image => image.naturalWidth)")
        assert min(sizes) > LEAST_WIDTH
        # All fits the window; what is wider scrolls within its own box.
        assert chromium.evaluate("document.documentElement.scrollWidth") <= width
        assert chromium.evaluate(_STICKING_OUT) == 0
        assert chromium.evaluate(_DANGLING) == []
        # What may be folded on the screen is there on paper.
        chromium.call("Emulation.setEmulatedMedia", media="print")
        chromium.evaluate("new Promise(done => requestAnimationFrame(() => setTimeout(done)))")
        assert chromium.evaluate(_HIDDEN) == 0
        reports = chromium.events
    assert [event for event in reports if event[0] in _TOLD] == []
    asked = [event["request"]["url"] for name, event in reports if "request" in event]
    assert asked and all(url.startswith(("data:", path.as_uri())) for url in asked)
    return len(sizes)
