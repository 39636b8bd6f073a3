#!/usr/bin/env python3
"""Opens the page of report.html with sample data in headless Chromium and looks at what it draws. Exit 77: skipped, something is missing.

MTLED_SCREENSHOTS=DIR keeps a picture of every mode of the viewer, in both themes and on a telephone."""
import base64
import copy
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

PROGRAM = sys.argv.pop(1)

try:
    import numpy as np
    import report_page_sample as sample
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service
except ImportError as error:
    print(f"SKIPPED: the page of report.html is tested with NumPy, Pillow and Selenium ({error})")
    sys.exit(77)
BROWSER, DRIVER = (next(filter(None, map(shutil.which, names)), None) for names in (("chromium", "chromium-browser", "google-chrome"), ("chromedriver", "chromium.chromedriver")))
if not BROWSER or not DRIVER:
    print("SKIPPED: the page of report.html is tested in Chromium with its driver (Debian: chromium, chromium-driver)")
    sys.exit(77)

GREY_ROUNDING = 1  # of 255: a window of a decoded byte, resampled by the browser
COLOUR_ROUNDING = 3  # of 255: a colour of 256 on the bar beside one of 254 values
READOUT = 0.5  # mm: vectors of a coarse grid, between its nodes
FLICKER = 30  # s: both images come within one, but pictures wait for a busy machine
CONTRAST = 4.5  # WCAG AA for text
SIZES = {"desktop": (1400, 1000, 1), "telephone": (390, 844, 2)}
MODES = ["images", "edges", "flicker", "checkerboard", "difference", "displacement", "jacobian", "shear"]
PLANES = {"axial": (0, 1, False), "coronal": (0, 2, True), "sagittal": (1, 2, True)}  # axes across and down, head up
RED, GREEN, PINK, BLUE, MAGENTA = (0xFF, 0x30, 0x30), (0x2F, 0xE0, 0x2F), (0xFF, 0x7F, 0xD0), (0x3F, 0x7B, 0xFF), (0xFF, 0x00, 0xC8)


def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars", "--window-size=1400,1000"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(service=Service(DRIVER), options=options)


class Page(unittest.TestCase):
    """A page in the browser, and ways to use it and to look at it."""

    @classmethod
    def setUpClass(cls):
        cls.scratch = tempfile.TemporaryDirectory()
        cls.phantom = sample.Phantom()
        cls.driver = browser()

    @classmethod
    def tearDownClass(cls):
        cls.driver.quit()
        cls.scratch.cleanup()

    def js(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, script, *arguments):
        for _ in range(600):
            if self.js(script, *arguments):
                return
            time.sleep(0.05)
        self.fail(f"never true: {script} {arguments}")

    def open(self, report, size="desktop", theme="light", motion="no-preference", clean=True):
        width, height, ratio = SIZES[size]
        media = [{"name": "prefers-color-scheme", "value": theme}, {"name": "prefers-reduced-motion", "value": motion}]
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": size == "telephone"})
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen", "features": media})
        if not isinstance(report, pathlib.Path):
            file = pathlib.Path(self.scratch.name) / "report.html"
            file.write_text(sample.assemble(report))
            report = file
        self.driver.get_log("browser")
        self.driver.get(report.as_uri())
        self.wait("return document.documentElement.dataset.state === 'ready'")
        if clean:
            self.clean()

    def clean(self):
        """Nothing went wrong, neither in the page's own eyes nor in the browser's."""
        self.assertIsNone(self.js("return document.documentElement.dataset.errors"))
        self.assertEqual([entry["message"] for entry in self.driver.get_log("browser")], [])

    def check_words(self, case=""):
        """No text of the page, of its elements' titles and names shows that something was missing."""
        texts = self.js("return [document.title, document.body.innerText, ...[...document.querySelectorAll('body *')].flatMap((e) => ['title', 'aria-label', 'aria-valuetext', 'alt'].map((a) => e.getAttribute(a) ?? ''))]")
        self.assertEqual([found for text in texts for found in re.findall(".*(?:NaN|undefined|null|Infinity).*", text)], [], case)

    def mode(self, name):
        self.js("document.querySelector(`.viewer input[value=${arguments[0]}]`).click()", name)
        self.wait("const v = document.querySelector('.viewer'); return v.dataset.mode === arguments[0] && v.dataset.state === 'drawn'", name)

    def toggle(self, label):
        self.js("[...document.querySelectorAll('.viewer .toggle')].find((t) => t.textContent === arguments[0]).firstChild.click()", label)
        self.settle()

    def slide(self, label, value):
        self.js("const s = document.querySelector(`.viewer .controls input[aria-label='${arguments[0]}']`); s.value = arguments[1]; s.dispatchEvent(new Event('input'))", label, value)
        self.settle()

    def settle(self):
        self.driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(arguments[0], 0)))")

    def picture(self, plane, row=0):
        """The pixels of a plane's canvas, [y, x, rgb]."""
        width, height, data = self.js("""const c = document.querySelectorAll(`canvas[data-plane=${arguments[0]}]`)[arguments[1]], p = Object.assign(document.createElement('canvas'), { width: c.width, height: c.height }).getContext('2d', { willReadFrequently: true });
            p.drawImage(c, 0, 0);
            const d = p.getImageData(0, 0, c.width, c.height).data;
            let s = ''; for (let i = 0; i < d.length; i += 8192) s += String.fromCharCode(...d.subarray(i, i + 8192)); return [c.width, c.height, btoa(s)];""", plane, row)
        return np.frombuffer(base64.b64decode(data), np.uint8).reshape(height, width, 4)[..., :3].astype(int)

    def place(self, plane, voxel, picture):
        """Where a voxel (x, y, z, may be between voxels) lies in the picture: column, row."""
        across, down, up = PLANES[plane]
        (height, width), n = picture.shape[:2], sample.SIZE
        scale = min(width / n[across], height / n[down])
        row = n[down] - 1 - voxel[down] if up else voxel[down]
        return (width - n[across] * scale) / 2 + (voxel[across] + 0.5) * scale, (height - n[down] * scale) / 2 + (row + 0.5) * scale

    def at(self, plane, voxel, picture):
        column, row = self.place(plane, voxel, picture)
        return tuple(picture[int(row), int(column)])

    def click(self, plane, voxel):
        picture = self.picture(plane)
        column, row = self.place(plane, voxel, picture)
        self.js("""const c = document.querySelector(`canvas[data-plane=${arguments[0]}]`), b = c.getBoundingClientRect(), f = b.width / c.width;
            const e = { button: 0, pointerId: 1, bubbles: true, clientX: b.left + arguments[1] * f, clientY: b.top + arguments[2] * f };
            c.setPointerCapture = () => {}; c.dispatchEvent(new PointerEvent('pointerdown', e)); c.dispatchEvent(new PointerEvent('pointerup', e));""", plane, column, row)
        self.settle()

    def slices(self):
        """The voxel of the crosshair, by the sliders: x, y, z."""
        return [int(self.js("return [...document.querySelectorAll(`.plane input[aria-label='${arguments[0]} slice']`)].at(-1).value", name)) for name in ("Sagittal", "Coronal", "Axial")]

    def readout(self):
        return dict(self.js("return [...document.querySelectorAll('.readout div')].map((d) => [d.children[0].textContent, d.children[1].textContent])"))

    def colour_bar(self):
        return np.array(self.js("const c = document.querySelector('.viewer .ramp'); return [...c.getContext('2d').getImageData(0, 0, 256, 1).data]")).reshape(256, 4)[:, :3]

    def keep(self, name):
        folder = os.environ.get("MTLED_SCREENSHOTS")
        if folder:
            pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
            shot = self.driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True})["data"]
            (pathlib.Path(folder) / f"{name}.png").write_bytes(base64.b64decode(shot))

    def check_planes(self):
        """Air and body are where the voxels of the fixed image say, left on the right, front up or left, head up; a mirrored plane would not agree. Returns where the fixed image is solid."""
        self.mode("images")
        self.toggle("Crosshair")
        for key, end in (("Lower", -700), ("Upper", -600)):
            self.js("const i = document.querySelector(`input[aria-label^='${arguments[0]} end']`); i.value = arguments[1]; i.dispatchEvent(new Event('change'))", key, end)
            self.settle()
        solid, (x, y, z) = self.phantom.hu["fixed"] > -650, self.slices()
        rng = np.random.default_rng(8)
        for plane, normal, at in (("axial", 2, z), ("coronal", 1, y), ("sagittal", 0, x)):
            picture, checked = self.picture(plane), 0
            for voxel in rng.integers(3, np.array(sample.SIZE) - 3, (600, 3)):
                voxel[normal] = at
                near = solid[tuple(slice(c - 2, c + 3) for c in voxel[::-1])]
                column, row = self.place(plane, voxel, picture)
                written = min(column, picture.shape[1] - column) < 60 or min(row, picture.shape[0] - row) < 60
                if near.all() == near.any() and not written:
                    self.assertEqual(self.at(plane, voxel, picture), (255,) * 3 if near.all() else (0,) * 3, (plane, voxel))
                    checked += 1
            self.assertGreater(checked, 60)
            self.assertTrue(self.js("return document.querySelector(`canvas[data-plane=${arguments[0]}]`).getAttribute('aria-label')", plane).startswith(plane.capitalize()))
            bar = "".join("x" if white else " " for white in (picture[-10] == 255).all(-1))  # the row of the scale bar
            length = max(map(len, bar.split()))
            scale = min(picture.shape[1] / sample.SIZE[PLANES[plane][0]], picture.shape[0] / sample.SIZE[PLANES[plane][1]]) / sample.SPACING
            self.assertLess(min(abs(length - mm * scale) for mm in (50, 100)), 3)  # px: its ends
        return solid


class ReportPage(Page):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.register = sample.register_report(cls.phantom)

    def test_every_mode_is_drawn_in_every_size_and_theme(self):
        for size in SIZES:
            for theme in ("light", "dark"):
                self.open(self.register, size, theme)
                self.assertEqual(self.js("return [...document.querySelectorAll('.viewer > .segmented input')].map((i) => i.value)"), MODES)
                for name in MODES:
                    self.mode(name)
                    for plane in PLANES:
                        for row in range(self.js("return document.querySelectorAll('canvas[data-plane=axial]').length")):
                            self.assertGreater(len(np.unique(self.picture(plane, row) @ (65536, 256, 1))), 20, (size, theme, name, plane))
                    self.assertLessEqual(*self.js("return [document.documentElement.scrollWidth, innerWidth]"), (size, theme, name))
                    self.assertEqual(self.js("return innerWidth"), SIZES[size][0])
                    self.keep(f"{size}-{theme}-{name}")
                self.clean()

    def test_planes_are_those_of_radiologists(self):
        self.open(self.register)
        solid = self.check_planes()
        voxel = np.array([30, 26, 52])
        self.click("axial", voxel)
        self.slide("Zoom", 6)
        for plane, (across, down, up) in PLANES.items():  # the voxel of the crosshair is in the middle
            picture, checked = self.picture(plane), set()
            scale = 6 * min(picture.shape[1] / sample.SIZE[across], picture.shape[0] / sample.SIZE[down])
            for step in np.ndindex(9, 9):
                at, (right, below) = voxel.copy(), np.array(step) - 4
                at[across] += right
                at[down] += -below if up else below
                near = solid[tuple(slice(c - 1, c + 2) if axis in (across, down) else c for axis, c in zip((2, 1, 0), at[::-1]))]
                if near.all() == near.any():
                    self.assertEqual(picture[int(picture.shape[0] / 2 + below * scale), int(picture.shape[1] / 2 + right * scale)].tolist(), [255 * near.all()] * 3)
                    checked.add(near.all())
            self.assertEqual(len(checked), 2, plane)

    def test_window_crosshair_and_readout(self):
        self.open(self.register)
        self.mode("images")
        self.assertEqual(self.readout().keys(), {"Position (LPS)", "Fixed image", "v (to the moving image)"})  # others are not decoded yet
        voxel = [34, 22, 52]
        self.click("axial", voxel)
        self.assertEqual(self.slices(), voxel)
        value = sample.LOW + sample.byte_of(sample.KNOWN_HU["fixed"]) / 255 * (sample.HIGH - sample.LOW)
        for plane in PLANES:
            for channel in self.at(plane, voxel, self.picture(plane)):
                self.assertLessEqual(abs(channel - (value + 160) / 400 * 255), GREY_ROUNDING, plane)
        self.wait("return document.querySelectorAll('.readout div').length === 8")
        shown, v = self.readout(), sample.displacement(np.array(sample.ORIGIN) + sample.SPACING * np.array(voxel))
        self.assertEqual(shown["Fixed image"], f"{value:.0f} HU")
        self.assertAlmostEqual(float(shown["Displacement"].split()[0]), np.linalg.norm(v), delta=0.1)  # a step of 254
        position = [float(p.replace("−", "-")) for p in shown["Position (LPS)"].rstrip(" m").split(",")]
        self.assertLess(np.abs(position - (np.array(sample.ORIGIN) + sample.SPACING * np.array(voxel))).max(), sample.SPACING / 2 + 0.05)
        vector = [float(p.replace("−", "-")) for p in shown["v (to the moving image)"].rstrip(" m").split(",")]
        self.assertLess(np.abs(vector - v).max(), 0.3)  # linear between nodes 16 mm apart

    def test_keys_wheel_and_sliders_step_the_slices(self):
        self.open(self.register)
        self.mode("images")
        start, before = self.slices(), self.picture("coronal")
        press = lambda key: (self.js("const c = document.querySelector('canvas[data-plane=coronal]'); c.focus(); c.dispatchEvent(new KeyboardEvent('keydown', { key: arguments[0], bubbles: true }))", key), self.settle())
        press("ArrowUp")
        self.assertEqual(self.slices(), [start[0], start[1] + 1, start[2]])
        self.assertTrue((self.picture("coronal") != before).any())
        press("PageDown")
        self.assertEqual(self.slices()[1], start[1] - 9)
        press("Home")
        self.assertEqual(self.slices()[1], 0)
        press("ArrowDown")
        self.assertEqual(self.slices()[1], 0)
        wheel = lambda plane: (self.js("document.querySelector(`canvas[data-plane=${arguments[0]}]`).dispatchEvent(new WheelEvent('wheel', { deltaY: -100, bubbles: true, cancelable: true }))", plane), self.settle())
        wheel("axial")  # without focus the wheel scrolls the page
        self.assertEqual(self.slices()[2], start[2])
        wheel("coronal")
        self.assertEqual(self.slices()[1], 1)
        self.js("const s = document.querySelector(\"input[aria-label='Sagittal slice']\"); s.value = 20; s.dispatchEvent(new Event('input'))")
        self.settle()
        self.assertEqual(self.slices(), [20, 1, start[2]])

    def test_edges_have_the_colours_of_the_papers(self):
        self.open(self.register)
        x, y, z = self.slices()
        edges = {name: e[z] for name, e in self.phantom.edges.items()}
        kinds = {RED: edges["before"] & ~edges["fixed"] & ~edges["mtled"], GREEN: edges["fixed"] & ~edges["before"] & ~edges["mtled"], PINK: edges["mtled"] & ~edges["fixed"] & ~edges["before"], BLUE: edges["mtled"] & edges["fixed"]}
        self.toggle("Crosshair")
        shown = {True: [{RED, GREEN}, {GREEN, PINK, BLUE}], False: [set(kinds)]}
        for pair in (True, False):
            self.assertEqual(self.js("return document.querySelectorAll('canvas[data-plane=axial]').length"), 2 if pair else 1)
            for row, expected in enumerate(shown[pair]):
                picture = self.picture("axial", row)
                for colour, mask in kinds.items():
                    places = [(i, j, z) for j, i in np.argwhere(mask) if 4 < j < 50 and 15 < i < 70]
                    self.assertGreater(len(places), 10)
                    for place in places:
                        if colour in expected:
                            self.assertEqual(self.at("axial", place, picture), colour)
                found = {c for c in kinds if (picture == c).all(-1).any()}
                self.assertEqual(found, expected)
            self.toggle("Before and after")
        self.toggle("Before and after")
        self.toggle("Colour-blind safe")
        picture = self.picture("axial")
        self.assertFalse(any((picture == c).all(-1).any() for c in kinds))
        self.assertTrue((picture == (0x56, 0xB4, 0xE9)).all(-1).any())
        self.assertEqual(self.js("return [...document.querySelectorAll('.viewer-legend .swatch')].map((s) => s.textContent)"), ["Moving image before (source)", "Fixed image (target)", "mtled (registered)", "Registered and fixed coincide"])

    def test_displacement_agrees_with_its_bar_and_its_arrows(self):
        self.open(self.register)
        self.mode("displacement")
        bar = self.colour_bar()
        self.assertEqual([tuple(bar[0]), tuple(bar[-1])], [(0x44, 0x01, 0x54), (0xFD, 0xE7, 0x25)])
        self.toggle("Crosshair")
        self.slide("Opacity", 1)
        node = np.array([8, 7, 13]) * 4  # a node of the arrows, in voxels
        self.assertEqual(node[2], self.slices()[2])
        with_arrows = self.picture("axial")
        self.toggle("Arrows")
        without = self.picture("axial")
        v = self.phantom.v[:, node[2], node[1], node[0]] / sample.SPACING
        middle = self.place("axial", node + 0.5 * v, without)
        beyond = self.place("axial", node - 0.2 * v, without)
        near = lambda picture, where: picture[int(where[1]) - 1 : int(where[1]) + 2, int(where[0]) - 1 : int(where[0]) + 2].min(-1).max()
        self.assertGreater(np.linalg.norm(v), 3)
        self.assertGreater(near(with_arrows, middle), 200)  # the white shaft, from y + v to y
        self.assertLess(near(without, middle), 200)
        self.assertTrue((with_arrows[int(beyond[1]), int(beyond[0])] == without[int(beyond[1]), int(beyond[0])]).all())
        size, body = np.linalg.norm(self.phantom.v, axis=0), self.phantom.body
        for voxel in ([30, 30, 52], [44, 20, 52], [58, 28, 52]):
            t = size[tuple(voxel[::-1])] / size[body].max()
            self.assertLessEqual(np.abs(np.array(self.at("axial", voxel, without)) - bar[round(255 * t)]).max(), COLOUR_ROUNDING)
        self.assertEqual(self.at("axial", (2, 30, 52), without), (0, 0, 0))  # outside the body nothing is known: the image shows

    def test_difference_and_folds(self):
        self.open(self.register)
        self.mode("difference")
        bar, voxel = self.colour_bar(), [34, 22, 52]
        self.assertEqual(self.js("return [...document.querySelectorAll('canvas[data-plane=axial]')].map((c) => c.dataset.row)"), ["before", "mtled"])
        values = [sample.LOW + sample.byte_of(sample.KNOWN_HU[name]) / 255 * (sample.HIGH - sample.LOW) for name in ("fixed", "mtled")]
        colour = np.array(self.at("axial", voxel, self.picture("axial", 1)))
        self.assertLessEqual(np.abs(colour - bar[round(255 * ((values[0] - values[1]) / 300 + 1) / 2)]).max(), COLOUR_ROUNDING)
        self.assertGreater(colour[0], colour[2])  # fixed brighter: orange, not blue
        after = self.picture("axial", 1)
        self.js("document.querySelector('.viewer .controls input[value=rigid]').focus(); document.querySelector('.viewer .controls input[value=rigid]').click()")
        self.settle()
        self.assertTrue((self.picture("axial", 1) != after).any())
        self.assertEqual(self.js("return [document.activeElement.value, document.activeElement.checked]"), ["rigid", True])
        self.mode("jacobian")
        self.toggle("Crosshair")
        folded = [(s.start + s.stop - 1) // 2 for s in sample.FOLDED[::-1]]
        self.click("axial", [folded[0], folded[1], 52])
        self.js("const s = document.querySelector(\"input[aria-label='Axial slice']\"); s.value = arguments[0]; s.dispatchEvent(new Event('input'))", folded[2])
        self.settle()
        for plane in PLANES:
            picture = self.picture(plane)
            self.assertEqual(self.at(plane, folded, picture), MAGENTA)
            scale = min(picture.shape[1] / sample.SIZE[PLANES[plane][0]], picture.shape[0] / sample.SIZE[PLANES[plane][1]])
            self.assertAlmostEqual((picture == MAGENTA).all(-1).sum() / (3 * scale) ** 2, 1, delta=0.1)  # 3 x 3 voxels, edges rounded to pixels

    def test_checkerboard_and_flicker(self):
        self.open(self.register, motion="reduce")
        self.mode("images")
        self.toggle("Crosshair")
        fixed = self.picture("coronal")
        self.mode("flicker")
        self.assertEqual(self.js("return [...document.querySelectorAll('.viewer .controls button')].map((b) => [b.textContent, b.ariaPressed])"), [["Play", None], ["Switch image", None]])  # reduced motion: it waits
        inner = lambda picture: picture[60:-60, 60:-60]
        self.assertTrue((inner(self.picture("coronal")) == inner(fixed)).all())
        time.sleep(1.2)
        self.assertTrue((inner(self.picture("coronal")) == inner(fixed)).all())
        self.js("[...document.querySelectorAll('.viewer button')].find((b) => b.textContent === 'Switch image').click()")
        self.settle()
        other = self.picture("coronal")
        self.assertFalse((inner(other) == inner(fixed)).all())
        self.js("[...document.querySelectorAll('.viewer input')].find((i) => i.value === 'before').click()")
        self.settle()
        self.assertTrue((self.picture("coronal") != other).any())
        self.mode("checkerboard")  # of the image before, alone
        board, before = self.picture("coronal"), None
        self.mode("images")
        self.js("[...document.querySelectorAll('.viewer .controls input')].find((i) => i.value === 'before').click()")
        self.settle()
        before = self.picture("coronal")
        spacing, tile = sample.SPACING, 30
        for column in range(4, sample.SIZE[0], 3):
            for row in range(12, sample.SIZE[2] - 12, 3):
                fraction = [(c * spacing / tile) % 1 for c in (column, row)]
                if not all(0.2 < f < 0.7 for f in fraction):
                    continue
                voxel = (column, self.slices()[1], sample.SIZE[2] - 1 - row)
                owner = before if (int(column * spacing // tile) + int(row * spacing // tile)) % 2 else fixed
                self.assertLessEqual(np.abs(np.array(self.at("coronal", voxel, board)) - self.at("coronal", voxel, owner)).max(), GREY_ROUNDING)
        self.open(self.register)
        self.mode("flicker")
        self.assertEqual(self.js("return [...[...document.querySelectorAll('.viewer .field')].find((f) => f.textContent.startsWith('Changes per second')).querySelectorAll('option')].map((o) => Number(o.value))"), [0.5, 1, 2])
        seen, end = set(), time.monotonic() + FLICKER
        while len(seen) < 2 and time.monotonic() < end:
            seen.add(self.picture("coronal").tobytes())
        self.assertEqual(len(seen), 2)

    def test_a_plane_can_be_enlarged_and_the_moving_space_is_its_own(self):
        self.open(self.register)
        self.mode("shear")
        v = self.phantom.v[:, 52, 30, 44]
        x, y, z = ([float(p.replace("−", "-")) for p in self.readout()["Position (LPS)"].rstrip(" m").split(",")])
        start = np.array(sample.ORIGIN) + sample.SPACING * np.array([44, 30, 52])
        self.assertLess(np.abs(np.array([x, y, z]) - start - v).max(), 0.3)  # the tissue that lies at the middle of the fixed image
        voxel = [round((p - o) / sample.SPACING) - s.start for p, o, s in zip((x, y, z), sample.ORIGIN, sample.CUT[::-1])]
        self.assertEqual(self.slices(), voxel)
        kpa = self.phantom.kpa[sample.CUT][tuple(voxel[::-1])]
        self.assertAlmostEqual(float(self.readout()["Shear modulus"].split()[0]), kpa, delta=5 / 254)
        self.assertEqual(self.js("return document.querySelectorAll('.aside tbody tr').length"), len(self.register["tissue"]["classes"]))
        self.assertIn("≥ 5", self.js("return document.querySelector('.viewer .ticks').textContent"))
        width = self.js("return document.querySelector('canvas[data-plane=sagittal]').width")
        self.js("document.querySelector(\"button[aria-label='Enlarge the sagittal plane']\").click()")
        self.settle()
        self.assertEqual(self.js("return [...document.querySelectorAll('.plane canvas')].map((c) => c.dataset.plane)"), ["sagittal"])
        self.assertGreater(self.js("return document.querySelector('canvas[data-plane=sagittal]').width"), 2 * width)
        self.js("document.querySelector('canvas[data-plane=sagittal]').dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape', bubbles: true }))")
        self.settle()
        self.assertEqual(self.js("return document.querySelectorAll('.plane canvas').length"), 3)
        self.clean()

    def test_charts_and_tables_say_what_the_data_say(self):
        self.open(self.register)
        self.assertEqual({s: self.js("return document.querySelectorAll(`#${arguments[0]} .curve`).length", s) for s in ("edges", "landmarks", "mechanics")}, {"edges": 3, "landmarks": 3, "mechanics": 3})
        curve = lambda: self.js("return document.querySelector('#edges .curve').getAttribute('d')")
        cells = lambda: self.js("return [...document.querySelectorAll('#edges tbody tr')].map((r) => [...r.cells].slice(1, 5).map((c) => c.textContent))")
        names, linear = [c["id"] for c in self.register["candidates"]], curve()
        for value, key in (("all", "hausdorff_all_edges_mm"), ("consistent", "hausdorff_mm")):
            self.js("document.querySelector(`#edges input[value=${arguments[0]}]`).click()", value)
            self.assertEqual(cells(), [[f"{mm:.2f}" for mm in self.register["edges"][n][key]] for n in names])
        self.assertNotEqual(curve(), linear)
        groups = self.js("return [...document.querySelectorAll('#edges .groups > *')].flatMap((g) => Array(g.colSpan).fill(g.textContent))")
        headings = self.js("return [...document.querySelectorAll('#edges thead tr:last-child th')].map((h) => [h.textContent, h.title])")
        self.assertEqual([(group, name) for group, (name, _) in zip(groups, headings)][5:8], [("All edges", "Modified Hausdorff mm"), ("All edges", "Within two voxels"), ("Consistent edges", "Within two voxels")])
        self.assertIn("10 mm", headings[5][1])
        self.js("document.querySelector('#edges input[value=consistent]').click(); document.querySelector('#edges input[value=log]').click()")
        self.assertNotIn("NaN", curve())
        heights = [float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", curve())]
        mm = self.register["edges"]["before"]["hausdorff_1_to_100_mm"]
        self.assertEqual(heights, sorted(heights, reverse=True))
        share = lambda at: (heights[0] - heights[at]) / (heights[0] - heights[99])
        self.assertAlmostEqual(share(84), np.log1p(mm[84]) / np.log1p(mm[99]), delta=0.002)  # a tenth of a pixel
        self.js("const s = document.querySelector('#edges .plot svg'); s.focus(); for (let i = 0; i < 60; ++i) s.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowRight' }))")
        tip = self.js("return document.querySelector('#edges .tip').textContent")
        self.assertEqual(tip, "60 % of the edges" + "".join(f"{c['name']} {self.register['edges'][c['id']]['hausdorff_1_to_100_mm'][59]:.2f} mm" for c in self.register["candidates"]))
        self.assertEqual(self.js("return [...document.querySelectorAll('#motions .mark.check')].map((m) => [m.closest('tr').cells[0].textContent, m.textContent])"), [["11", "Look at this one"]])
        self.assertEqual(self.js("return document.querySelectorAll('#motions tbody tr')[1].cells[5].textContent"), "–")
        self.assertEqual(self.js("return [...document.querySelectorAll('#verdict .card .mark')].map((m) => m.textContent)"), ["Good", "Good", "Check", "Problem", "Info"])
        self.assertEqual(self.js("return document.querySelector('#time tfoot').textContent"), "Total83.4812")
        self.assertEqual(self.js("return document.querySelector('h1 .file').title"), self.register["inputs"][0]["path"])

    def test_shares_of_landmarks_are_read_between_their_distances(self):
        distances = {c["name"]: np.sort(self.register["landmarks"][c["id"]]["distances_mm"]) for c in self.register["candidates"]}
        stops = sorted({0, *np.concatenate([*distances.values()])})
        for presses in (1, 40, 150, len(stops)):
            self.open(self.register)
            self.js("const s = document.querySelector('#landmarks .plot svg'); s.focus(); for (let i = 0; i < arguments[0]; ++i) s.dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowRight' }))", presses)
            mm = stops[presses - 1]
            self.assertEqual(self.js("return document.querySelector('#landmarks .tip').textContent"), f"{mm:.2f} mm" + "".join(f"{name} {np.sum(d <= mm):.0f} %" for name, d in distances.items()))

    def test_every_registration_has_a_style_of_its_own(self):
        self.open(sample.evaluate_report(self.phantom, sample.OTHERS))
        keys = self.js("""return [...document.querySelectorAll('#edges tbody .key')].map((k) => [...k.children].flatMap((p) => [p.getAttribute('d'), p.getAttribute('stroke-dasharray'), getComputedStyle(p)[p.classList.contains('line') ? 'stroke' : 'fill']]))""")
        self.assertEqual(len(keys), 7)
        for part, name in ((1, "dash"), (2, "colour"), (3, "marker")):
            self.assertEqual(len({k[part] for k in keys}), 7, name)
        legend = lambda: self.js("return [...document.querySelectorAll('.viewer-legend .swatch')].map((s) => s.textContent)")
        self.assertEqual(legend()[2], "After (registered)")  # one at a time, and its name
        self.toggle("ANTs")
        self.assertEqual(legend()[2], "ANTs, After (registered)")
        self.keep("compared")
        self.open(self.register)
        own = self.js("return [...document.querySelectorAll('#edges tbody .key .line')].map((p) => p.getAttribute('stroke-dasharray'))")
        self.assertEqual([keys[0][1], keys[-1][1]], [own[0], own[-1]])  # before and the one judged look alike in every report

    def test_charts_that_were_replaced_are_let_go(self):
        count = """window.kept = { observed: 0, listeners: 0 };
            const [observe, unobserve, listen] = [ResizeObserver.prototype.observe, ResizeObserver.prototype.unobserve, window.addEventListener];
            ResizeObserver.prototype.observe = function (...a) { ++kept.observed; return observe.apply(this, a); };
            ResizeObserver.prototype.unobserve = function (...a) { --kept.observed; return unobserve.apply(this, a); };
            window.addEventListener = function (...a) { ++kept.listeners; return listen.apply(this, a); };"""
        script = self.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": count})["identifier"]
        self.addCleanup(self.driver.execute_cdp_cmd, "Page.removeScriptToEvaluateOnNewDocument", {"identifier": script})
        self.open(self.register)
        before = self.js("return kept")
        self.assertGreater(before["observed"], 4)  # charts, planes and the cloud
        for value in ("log", "consistent", "linear", "all"):
            self.js("document.querySelector(`#edges input[value=${arguments[0]}]`).click()", value)
            self.settle()
        self.assertEqual(self.js("return kept"), before)
        width = lambda: self.js("return Number(document.querySelector('#edges .plot > svg').getAttribute('viewBox').split(' ')[2])")
        wide = width()
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {"width": 900, "height": 1000, "deviceScaleFactor": 1, "mobile": False})
        self.wait("return document.querySelector('#edges .chart').clientWidth === Number(document.querySelector('#edges .plot > svg').getAttribute('viewBox').split(' ')[2])")
        self.assertLess(width(), wide)  # the new one still follows the page

    def test_cards_fill_their_rows_evenly(self):
        item = self.register["verdict"]["items"][0]
        rows = "return Object.values(Object.groupBy(document.querySelectorAll('#verdict .card'), (c) => c.offsetTop)).map((r) => r.length)"
        for count, desktop, telephone in ((5, [5], [1] * 5), (6, [3, 3], [1] * 6), (7, [4, 3], [1] * 7)):
            for size, expected in (("desktop", desktop), ("telephone", telephone)):
                self.open({**sample.minimal_report(self.phantom), "view": None, "verdict": {**self.register["verdict"], "items": [item] * count}}, size)
                self.assertEqual(self.js(rows), expected)

    def test_the_volume_ratio_says_where_it_is_cut(self):
        """A scale that ends within the values; nothing folds, so nothing is magenta, not even the lowest byte."""
        report = copy.deepcopy(self.register)
        at = next(i for i, volume in enumerate(report["view"]["volumes"]) if volume["id"] == "jacobian")
        ratio = np.where(self.phantom.jacobian < 0, 0.3, self.phantom.jacobian)
        voxel = [(s.start + s.stop - 1) // 2 for s in sample.FOLDED[::-1]]
        for low, bar, value in ((0.5, ["≤ 0.5", "≥ 1.5"], "≤ 0.50"), (0.01, ["0", "≥ 2"], "0.30"), (0, ["0", "≥ 2"], "0.30")):
            values = np.where(self.phantom.jacobian < 0, 0.0, ratio) if low == 0 else ratio
            report["view"]["volumes"][at] = sample.scalar("jacobian", "Volume ratio", values, self.phantom.body, low, 2 if low < 0.5 else 1.5, "moving / fixed", map="diverging", middle=1, open_start=True, open_end=True)
            self.open(report)
            self.mode("jacobian")
            self.toggle("Crosshair")
            self.click("axial", [voxel[0], voxel[1], 52])
            self.js("const s = document.querySelector(\"input[aria-label='Axial slice']\"); s.value = arguments[0]; s.dispatchEvent(new Event('input'))", voxel[2])
            self.settle()
            for plane in PLANES:
                self.assertFalse((self.picture(plane) == MAGENTA).all(-1).any(), (low, plane))
            self.wait("return document.querySelectorAll('.readout div').length === 8")
            if low:
                self.assertEqual(self.readout()["Volume ratio"], value)
            self.js("const s = [...document.querySelectorAll('.viewer .field')].find((f) => f.textContent.startsWith('Range')).querySelector('select'); s.selectedIndex = s.length - 1; s.dispatchEvent(new Event('change'))")
            self.settle()
            ticks = self.js("return [...document.querySelectorAll('.viewer .ticks span')].sort((a, b) => parseFloat(a.style.left) - parseFloat(b.style.left)).map((s) => s.textContent)")
            self.assertEqual([ticks[0], ticks[-1]], bar)

    def test_rigidity_is_explained_as_it_was_measured(self):
        text = lambda: self.js("return document.querySelector('#reading').textContent")
        found, best = "from the rigid motion that was found or given", "from the rigid motion that fits best"
        for present, missing, expected in (("motions", "rigidity", (True, False)), ("rigidity", "motions", (False, True))):
            self.open({**self.register, "view": None, "nodes": None, missing: None})
            self.assertEqual((found in text(), best in text()), expected)

    def test_the_cloud_turns_and_deforms(self):
        self.open(self.register)
        state = "const c = document.querySelector('.cloud canvas'); return c.toDataURL()"
        first = self.js(state)
        self.js("const s = document.querySelector(\".cloud input[type=range]\"); s.value = 0; s.dispatchEvent(new Event('input'))")
        self.settle()
        rest = self.js(state)
        self.js("document.querySelector('.cloud canvas').dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowLeft' }))")
        self.settle()
        turned = self.js(state)
        self.js("document.querySelector('.cloud input[value=label]').click()")
        self.settle()
        self.assertEqual(len({first, rest, turned, self.js(state)}), 4)
        self.assertEqual(self.js("return [...document.querySelectorAll('.cloud .swatch')].map((s) => s.textContent)"), ["Soft tissue", *map(str, sample.NODE_LABELS)])
        ticks = lambda field: self.js("document.querySelector(`.cloud input[value='${arguments[0]}']`).click(); return [...document.querySelectorAll('.cloud .ticks span')].at(-1).textContent", field)
        self.assertEqual(ticks(1), "≥ 5")
        self.assertNotIn("≥", ticks(0))

    def test_evaluation_and_minimal_data(self):
        self.open(sample.evaluate_report(self.phantom))
        self.assertEqual(self.js("return document.querySelectorAll('#edges .curve').length"), 2)
        self.assertEqual(self.js("return document.querySelector('#landmarks tbody tr').textContent"), " Before3––––")
        self.assertEqual(self.js("return document.querySelector('h1').textContent"), "warped.nii.gz judged against fixed.nii.gz")
        self.assertEqual(self.js("return [...document.querySelectorAll('#contours tbody tr')].map((r) => [...r.cells].slice(2).map((c) => c.textContent))"), [[f"{far * 1.1 * scale:.2f}" for far in (1, 0.8, 2.5, 6)] + ["412", "0"] for scale in (3.2, 0.35)])
        self.assertEqual(self.js("return [...document.querySelectorAll('#inputs thead th')].map((h) => h.textContent)"), ["What", "File", "Size"])  # nothing has an MD5
        self.keep("evaluate")
        self.open(sample.minimal_report(self.phantom))
        self.assertEqual(self.js("return [...document.querySelectorAll('section')].map((s) => s.id)"), ["verdict", "viewer", "inputs", "reading"])
        for name in self.js("return [...document.querySelectorAll('.viewer > .segmented input')].map((i) => i.value)"):
            self.mode(name)
        self.clean()
        self.keep("minimal")
        self.open({**sample.minimal_report(self.phantom), "view": None, "candidates": []})
        self.assertEqual(self.js("return [...document.querySelectorAll('section')].map((s) => s.id)"), ["verdict", "inputs", "reading"])

    def test_whatever_may_be_missing_may_be_missing(self):
        def without_numbers(part):
            if isinstance(part, dict):
                return {key: value if key == "label" else without_numbers(value) for key, value in part.items()}
            if isinstance(part, list):
                return [without_numbers(value) for value in part]
            return part if isinstance(part, str) else None

        measured = ("edges", "landmarks", "labels", "rigidity", "jacobian", "inverse_consistency", "motions", "tissue", "solver", "stages", "edge_settings")
        self.open({**self.register, **{key: without_numbers(self.register[key]) for key in measured}})
        self.check_words()
        light = {**self.register, "view": None, "nodes": None}
        for key in {*light} - {"version", "kind", "program", "verdict", "candidates"}:
            for changed in ({**light, key: None}, {k: v for k, v in light.items() if k != key}):
                self.open(changed)
                self.check_words(key)
        for part in measured:
            if isinstance(light[part], dict):
                self.open({**light, part: {}})
                self.check_words(part)
        for key in ("labels", "label", "scalars", "shown"):
            self.open({**light, "nodes": {k: v for k, v in self.register["nodes"].items() if k != key}})
            self.check_words(key)
        for key in ("arrows", "volumes"):
            self.open({**self.register, "view": {k: v for k, v in self.register["view"].items() if k != key}} if key == "arrows" else {**self.register, "view": {**self.register["view"], "volumes": []}})
        volumes = [{k: v for k, v in volume.items() if k not in ("windows", "unit", "name")} for volume in self.register["view"]["volumes"]]
        self.open({**self.register, "view": {**self.register["view"], "volumes": volumes}})
        for name in MODES:
            self.mode(name)
            self.check_words(name)
        self.clean()

    def test_text_is_data_not_markup(self):
        report = {**sample.minimal_report(self.phantom), "view": None, "warnings": ["</script><img src=x onerror=alert(1)> $& & <b>"]}
        self.open(report)
        self.assertEqual(self.js("return document.querySelector('#verdict .notice li').textContent"), report["warnings"][0])
        self.assertEqual(self.js("return document.querySelectorAll('#verdict b, #verdict img').length"), 0)

    def test_a_broken_picture_is_said_and_the_rest_is_drawn(self):
        report = copy.deepcopy(self.register)
        report["view"]["volumes"][0]["mosaic"]["picture"] = "data:image/png;base64,AAAA"
        self.open(report, clean=False)
        self.assertIn("“Fixed image” cannot be decoded", self.js("return document.querySelector('.viewer .notice').textContent"))
        self.assertIn("Fixed image", self.js("return document.documentElement.dataset.errors"))
        self.assertTrue(self.js("return !document.getElementById('errors').hidden && document.querySelectorAll('#edges .curve').length === 3"))
        self.driver.get_log("browser")
        report["view"]["volumes"][0]["mosaic"] = {**self.register["view"]["volumes"][0]["mosaic"], "columns": 11}
        self.open(report, clean=False)
        self.assertIn("pixels, but", self.js("return document.querySelector('.viewer .notice').textContent"))
        self.open({**report, "version": 2}, clean=False)
        self.assertIn("version 2", self.js("return document.getElementById('errors').textContent"))
        self.driver.get_log("browser")

    def test_text_can_be_read_in_both_themes(self):
        """Contrast of every text with what lies behind it; the theme's button changes both."""
        script = """
            const rgb = (c) => { const p = document.createElement('canvas').getContext('2d', { willReadFrequently: true }); p.fillStyle = c; p.fillRect(0, 0, 1, 1); return [...p.getImageData(0, 0, 1, 1).data]; };
            const light = ([r, g, b]) => [r, g, b].map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((s, v, i) => s + v * [0.2126, 0.7152, 0.0722][i], 0);
            const seen = new Map();
            for (const e of document.querySelectorAll('body *')) {
              if (e.closest('script, style, noscript, option, .unseen, .skip') || !e.checkVisibility() || ![...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())) continue;
              const style = getComputedStyle(e);
              let behind = e;
              while (behind && rgb(getComputedStyle(behind).backgroundColor)[3] < 255) behind = behind.parentElement;
              const [a, b] = [light(rgb(e instanceof SVGElement ? style.fill : style.color)), light(rgb(getComputedStyle(behind).backgroundColor))];
              const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
              const name = e.tagName + '.' + (e.getAttribute('class') ?? '') + ' in ' + e.parentElement.tagName + ' on ' + behind.tagName + '.' + behind.className;
              seen.set(name, Math.min(ratio, seen.get(name) ?? 99));
            }
            return [...seen];"""
        compared = sample.evaluate_report(self.phantom, sample.OTHERS)
        for report, theme in ((self.register, "light"), (self.register, "dark"), (compared, "light")):
            self.open(report, theme=theme)
            for _ in range(2):
                found = self.js(script)
                self.assertGreater(len(found), 30)
                self.assertEqual([pair for pair in found if pair[1] < CONTRAST], [])
                page = self.js("return getComputedStyle(document.body).backgroundColor")
                self.js("document.getElementById('theme').click()")
                self.assertNotEqual(self.js("return getComputedStyle(document.body).backgroundColor"), page)

    def test_everything_to_use_has_a_name(self):
        self.open(self.register)
        nameless = self.js("""return [...document.querySelectorAll('button, input, select, canvas[tabindex], [role=img], [role=region]')].filter((e) => !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.[0]?.textContent.trim())).map((e) => e.outerHTML)""")
        self.assertEqual(nameless, [])
        levels = [int(t[1]) for t in self.js("return [...document.querySelectorAll('h1, h2, h3')].map((h) => h.tagName)")]
        self.assertEqual(levels[0], 1)
        self.assertTrue(all(b - a <= 1 for a, b in zip(levels, levels[1:])))

    def test_print_is_light_and_without_controls(self):
        self.open(self.register, theme="dark")
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": [{"name": "prefers-color-scheme", "value": "dark"}]})
        self.assertEqual(self.js("return getComputedStyle(document.body).backgroundColor"), "rgb(255, 255, 255)")
        self.assertEqual(self.js("return [...document.querySelectorAll('button, select, input')].filter((e) => e.checkVisibility()).length"), 0)
        self.assertTrue(self.js("return document.querySelector('.plane canvas').checkVisibility()"))
        pdf = base64.b64decode(self.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": False})["data"])
        self.assertGreater(len(re.findall(rb"/Type\s*/Page\b", pdf)), 2)
        folder = os.environ.get("MTLED_SCREENSHOTS")
        if folder:
            (pathlib.Path(folder) / "print.pdf").write_bytes(pdf)


def write_nrrd(file, array):
    """An array [z, y, x] or [z, y, x, 3] on the sample's grid, as a scanner may store it: x from left to right, y from the back to the front, slices along y."""
    stored = np.ascontiguousarray(array[:, ::-1, ::-1].swapaxes(0, 1).astype("<f4"))
    n, h = stored.shape, sample.SPACING
    origin = np.array(sample.ORIGIN) + [h * (sample.SIZE[0] - 1), h * (sample.SIZE[1] - 1), 0]
    vector = array.ndim == 4
    header = ["NRRD0004", "type: float", f"dimension: {array.ndim}", "space: left-posterior-superior", f"sizes: {'3 ' if vector else ''}{n[2]} {n[1]} {n[0]}",
              f"space directions: {'none ' if vector else ''}({-h},0,0) (0,0,{h}) (0,{-h},0)", f"kinds: {'vector ' if vector else ''}domain domain domain", "endian: little", "encoding: raw", f"space origin: ({origin[0]},{origin[1]},{origin[2]})"]
    file.write_bytes("\n".join(header).encode() + b"\n\n" + stored.tobytes())


class ReportOfTheProgram(Page):
    def test_what_evaluate_writes(self):
        """From images to pixels: images stored along other axes, warped by a field, stand upright in the planes and meet."""
        folder = pathlib.Path(self.scratch.name)
        write_nrrd(folder / "fixed.nrrd", self.phantom.hu["fixed"])
        write_nrrd(folder / "moving.nrrd", self.phantom.hu["before"])
        write_nrrd(folder / "field.nrrd", np.moveaxis(self.phantom.v, 0, -1))
        done = subprocess.run([PROGRAM, "evaluate", "-f", folder / "fixed.nrrd", "-m", folder / "moving.nrrd", "-t", folder / "field.nrrd", "--beside", f"again={folder / 'field.nrrd'}", "--contour", "lungs", "--reference-transform", folder / "field.nrrd", "-o", folder / "out"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        report = folder / "out" / "report.html"
        for size in SIZES:
            self.open(report, size)
            for name in MODES[:-1]:
                self.mode(name)
                self.keep(f"program_{size}_{name}")
            self.clean()
            self.assertLessEqual(self.js("return document.documentElement.scrollWidth - innerWidth"), 0)
        self.open(report)
        space = self.js("return JSON.parse(document.getElementById('report-data').textContent).view.spaces.fixed")
        self.assertEqual((tuple(space["size"]), tuple(space["origin_mm"]), space["spacing_mm"]), (sample.SIZE, sample.ORIGIN, sample.SPACING))
        self.check_planes()
        rows = lambda section: self.js("return [...document.querySelectorAll(`#${arguments[0]} tbody tr`)].map((r) => [...r.cells].map((c) => c.textContent.trim()))", section)
        self.assertEqual([row[:2] for row in rows("contours")], [["lungs", "Before"], ["lungs", "again"], ["lungs", "Registered"]])
        self.assertEqual([row[0] for row in rows("field")], ["again", "Registered"])
        self.assertEqual(rows("field")[0][1:], rows("field")[1][1:])
        self.assertIn("0.000 mm", self.js("return document.querySelector('#reference').textContent"))
        self.assertGreater(self.js("return document.querySelector('#figures img').naturalWidth"), 500)
        x, y, z = self.slices()
        shown = [float(part) for part in self.readout()["v (to the moving image)"].replace("\u2212", "-").removesuffix(" mm").split(", ")]
        np.testing.assert_allclose(shown, self.phantom.v[:, z, y, x], atol=READOUT)


if __name__ == "__main__":
    unittest.main()
