#!/usr/bin/env python3
"""Opens an orthophoto, a surface model and a server's map in QGIS and looks at what it draws.

    show.py PLACES.json FOLDER URL    QT_QPA_PLATFORM=offscreen where there is no screen

PLACES.json: {"middle": [lon, lat], "places": [{"name", "at": [lon, lat], "color": red|blue|yellow|grey}],
"heights": [{"name", "at", "m"}]}. FOLDER holds ortho.tif and dsm.tif and gets a picture of each layer. URL is that
of a dataset, http://host/d/name. Exit code 1 when anything is not where it is.

SPDX-License-Identifier: Apache-2.0
"""
import json
import os
import sys
import urllib.request

from qgis.core import (
    QgsApplication, QgsCoordinateReferenceSystem, QgsCoordinateTransform, QgsMapRendererSequentialJob, QgsMapSettings,
    QgsPointXY, QgsProject, QgsRasterLayer, QgsRectangle)
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

SIDE_PX = 640
HALF_M = 150  # of the map shown, metres of Web Mercator
MERCATOR = QgsCoordinateReferenceSystem("EPSG:3857")
LOOKS = {
    "red": lambda r, g, b: r > g + 80 and r > b + 80,
    "blue": lambda r, g, b: b > r + 80 and b > g + 40,
    "yellow": lambda r, g, b: r > 180 and g > 140 and b < 110,
    "grey": lambda r, g, b: max(r, g, b) - min(r, g, b) < 30 and r < 160,
}
failed = []


def check(what, good, seen):
    print(("ok: " if good else "FAILED: ") + what + ("" if good else f": {seen}"))
    if not good:
        failed.append(what)


def mercator(lonlat):
    way = QgsCoordinateTransform(QgsCoordinateReferenceSystem("EPSG:4326"), MERCATOR, QgsProject.instance())
    return way.transform(QgsPointXY(*lonlat))


def layers(folder, url):
    def tiles(template):
        return f"type=xyz&url={template}".replace("{", "%7B").replace("}", "%7D")

    with urllib.request.urlopen(f"{url}/map.json") as answer:
        zooms = json.load(answer)
    yield "ortho", folder + "/ortho.tif", "gdal"
    # Where map.json says that they are: of /map/{z}/{x}/{y}, which redirects, QGIS shows nothing.
    yield "xyz", tiles(zooms["tiles"][0]) + f"&zmin={zooms['minzoom']}&zmax={zooms['maxzoom']}", "wms"
    yield "wmts", ("crs=EPSG:3857&format=image/png&layers=" + url.rsplit("/", 1)[1]
                   + f"&styles=default&tileMatrixSet=WebMercatorQuad&url={url}/wmts.xml"), "wms"


def draw(layer, middle, path):
    settings = QgsMapSettings()
    settings.setLayers([layer])
    settings.setDestinationCrs(MERCATOR)
    settings.setBackgroundColor(QColor(255, 255, 255))
    settings.setOutputSize(QSize(SIDE_PX, SIDE_PX))
    settings.setExtent(QgsRectangle(middle.x() - HALF_M, middle.y() - HALF_M, middle.x() + HALF_M, middle.y() + HALF_M))
    job = QgsMapRendererSequentialJob(settings)
    job.start()
    job.waitForFinished()
    image = job.renderedImage()
    image.save(path)
    return settings, image


def main(places_path, folder, url):
    with open(places_path, encoding="utf-8") as file:
        known = json.load(file)
    middle = mercator(known["middle"])
    for name, where, provider in layers(folder, url):
        layer = QgsRasterLayer(where, name, provider)
        check(f"{name} opens", layer.isValid(), layer.error().message())
        if not layer.isValid():
            continue
        settings, image = draw(layer, middle, os.path.join(folder, f"qgis-{name}.png"))
        for place in known["places"]:
            at = settings.mapToPixel().transform(mercator(place["at"]))
            seen = image.pixelColor(int(at.x()), int(at.y())).getRgb()[:3]
            check(f"{name}: {place['name']} is {place['color']}", LOOKS[place["color"]](*seen), seen)
    dsm = QgsRasterLayer(folder + "/dsm.tif", "dsm", "gdal")
    check("dsm opens", dsm.isValid(), dsm.error().message())
    way = QgsCoordinateTransform(QgsCoordinateReferenceSystem("EPSG:4326"), dsm.crs(), QgsProject.instance())
    for place in known["heights"]:
        seen, there = dsm.dataProvider().sample(way.transform(QgsPointXY(*place["at"])), 1)
        check(f"dsm: {place['name']} is {place['m']} m high", there and abs(seen - place["m"]) < 2, seen)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    application = QgsApplication([], False)
    application.initQgis()
    main(*sys.argv[1:])
    application.exitQgis()
    sys.exit(1 if failed else 0)
