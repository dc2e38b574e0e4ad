/* OpenAPI 3.0 schemas of the JSON that the service sends and accepts. ' stands for a quotation
 * mark.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_OPENAPI_SCHEMAS_H
#define SERVER_OPENAPI_SCHEMAS_H

#define OPENAPI_TEXT "{'type':'string'}"
#define OPENAPI_NUMBER "{'type':'number'}"
#define OPENAPI_INTEGER "{'type':'integer'}"
#define OPENAPI_OF(name) "{'$ref':'#/components/schemas/" name "'}"
#define OPENAPI_LIST_OF(name) "{'type':'array','items':" OPENAPI_OF(name) "}"
#define OPENAPI_NUMBERS(least, most)                                                               \
    "{'type':'array','items':" OPENAPI_NUMBER ",'minItems':" #least ",'maxItems':" #most "}"

#define OPENAPI_EXTENT(n)                                                                          \
    "{'type':'object','properties':{'spatial':{'type':'object','properties':{"                     \
    "'bbox':{'type':'array','items':" OPENAPI_NUMBERS(n, n) "},'crs':" OPENAPI_TEXT "}}}}"

/* X(name, schema) */
#define OPENAPI_SCHEMAS(X)                                                                         \
    X("Problem",                                                                                   \
      "{'type':'object','required':['type','title','status','detail'],'properties':{"              \
      "'type':" OPENAPI_TEXT ",'title':" OPENAPI_TEXT ",'status':" OPENAPI_INTEGER                 \
      ",'detail':" OPENAPI_TEXT ",'instance':" OPENAPI_TEXT ",'dataset':" OPENAPI_TEXT             \
      ",'tile':{'type':'object','required':['z','x','y'],'properties':{'z':" OPENAPI_INTEGER       \
      ",'x':" OPENAPI_INTEGER ",'y':" OPENAPI_INTEGER "}}}}")                                      \
    X("Link", "{'type':'object','required':['rel','href'],'properties':{'rel':" OPENAPI_TEXT       \
              ",'href':" OPENAPI_TEXT ",'type':" OPENAPI_TEXT ",'title':" OPENAPI_TEXT "}}")       \
    X("Landing",                                                                                   \
      "{'type':'object','required':['title','links'],'properties':{'title':" OPENAPI_TEXT          \
      ",'description':" OPENAPI_TEXT ",'links':" OPENAPI_LIST_OF("Link") "}}")                     \
    X("Conformance", "{'type':'object','required':['conformsTo'],'properties':{'conformsTo':"      \
                     "{'type':'array','items':" OPENAPI_TEXT "}}}")                                \
    X("Splats",                                                                                    \
      "{'type':'object','required':['revision','origin','minzoom','maxzoom'],'properties':{"       \
      "'revision':" OPENAPI_TEXT ",'origin':" OPENAPI_NUMBERS(                                     \
          3, 3) ",'minzoom':" OPENAPI_INTEGER ",'maxzoom':" OPENAPI_INTEGER                        \
                ",'shDegree':" OPENAPI_INTEGER ",'embedLength':" OPENAPI_INTEGER                   \
                ",'antialiased':{'type':'boolean'},'tiles':" OPENAPI_INTEGER                       \
                ",'gaussians':" OPENAPI_INTEGER ",'tileTemplate':" OPENAPI_TEXT                    \
                ",'viewTemplate':" OPENAPI_TEXT ",'formats':{'type':'array','items':" OPENAPI_TEXT \
                "},'heights':" OPENAPI_TEXT ",'created':" OPENAPI_TEXT                             \
                ",'taken':{'type':'array','items':" OPENAPI_TEXT ",'minItems':2,'maxItems':2}}}")  \
    X("Collection",                                                                                \
      "{'type':'object','required':['id','extent','links'],'properties':{'id':" OPENAPI_TEXT       \
      ",'title':" OPENAPI_TEXT ",'collectionType':" OPENAPI_TEXT ",'attribution':" OPENAPI_TEXT    \
      ",'extent':" OPENAPI_EXTENT(4) ",'contentExtent':" OPENAPI_EXTENT(                           \
          6) ",'links':" OPENAPI_LIST_OF("Link") ",'splats':" OPENAPI_OF("Splats") "}}")           \
    X("Collections",                                                                               \
      "{'type':'object','required':['links','collections'],'properties':{'links'"                  \
      ":" OPENAPI_LIST_OF("Link") ",'collections':" OPENAPI_LIST_OF("Collection") "}}")            \
    X("TileJSON",                                                                                  \
      "{'type':'object','required':['tilejson','tiles'],'properties':{'tilejson':" OPENAPI_TEXT    \
      ",'tiles':{'type':'array','items':" OPENAPI_TEXT ",'minItems':1},'minzoom':" OPENAPI_INTEGER \
      ",'maxzoom':" OPENAPI_INTEGER ",'bounds':" OPENAPI_NUMBERS(                                  \
          4, 4) ",'center':" OPENAPI_NUMBERS(3, 3) ",'attribution':" OPENAPI_TEXT "}}")            \
    X("Style",                                                                                     \
      "{'type':'object','required':['version','sources','layers'],'properties':{"                  \
      "'version':{'type':'integer','enum':[8]},'name':" OPENAPI_TEXT ",'center':" OPENAPI_NUMBERS( \
          2, 2) ",'zoom':" OPENAPI_NUMBER ",'pitch':" OPENAPI_NUMBER                               \
                ",'terrain':{'type':'object','required':['source'],'properties':{'source'"         \
                ":" OPENAPI_TEXT ",'exaggeration':" OPENAPI_NUMBER                                 \
                "}},'sources':{'type':'object',"                                                   \
                "'additionalProperties':{'type':'object','required':['type','tiles']}}"            \
                ",'layers':{'type':'array','items':{'type':'object','required':['id','type']}}}}") \
    X("Tileset",                                                                                   \
      "{'type':'object','required':['asset','geometricError','root'],'properties':{"               \
      "'asset':{'type':'object','required':['version'],'properties':{'version':" OPENAPI_TEXT "}}" \
      ",'geometricError':" OPENAPI_NUMBER ",'root':{'type':'object'}}}")                           \
    X("Appearances",                                                                               \
      "{'type':'object','required':['appearances'],'properties':{'numberMatched':" OPENAPI_INTEGER \
      ",'numberReturned':" OPENAPI_INTEGER ",'links':" OPENAPI_LIST_OF(                            \
          "Link") ","                                                                              \
                  "'default':" OPENAPI_TEXT ",'embeddingLength':" OPENAPI_INTEGER                  \
                  ",'appearances':{'type':'array','items':{'type':'object','required':['name','"   \
                  "links'],"                                                                       \
                  "'properties':{'name':" OPENAPI_TEXT ",'number':" OPENAPI_INTEGER                \
                  ",'kept':{'type':'boolean'}"                                                     \
                  ",'time':" OPENAPI_TEXT ",'lon':" OPENAPI_NUMBER ",'lat':" OPENAPI_NUMBER        \
                  ",'distance_m':" OPENAPI_NUMBER ",'colour':" OPENAPI_TEXT                        \
                  ",'colour_distance':" OPENAPI_NUMBER ",'thumbnail':" OPENAPI_TEXT                \
                  ",'links':" OPENAPI_LIST_OF("Link") "}}}}}")                                     \
    X("Appearance",                                                                                \
      "{'type':'object','required':['appearance','embedding','nearest','links'],'properties':{"    \
      "'appearance':" OPENAPI_TEXT ",'embedding':{'type':'array','items':" OPENAPI_NUMBER "}"      \
      ",'nearest':{'type':'array','items':{'type':'object','required':['name','cosine'],"          \
      "'properties':{'name':" OPENAPI_TEXT ",'cosine':" OPENAPI_NUMBER "}}}"                       \
      ",'links':" OPENAPI_LIST_OF("Link") "}}")                                                    \
    X("Kept", "{'type':'object','required':['name','appearance'],'description':'as Appearance, "   \
              "of what the "                                                                       \
              "name stands for; problem: why that means nothing in this revision','properties':{"  \
              "'name':" OPENAPI_TEXT ",'appearance':" OPENAPI_TEXT ",'problem':" OPENAPI_TEXT      \
              ",'embedding':{'type':'array','items':" OPENAPI_NUMBER                               \
              "},'links':" OPENAPI_LIST_OF("Link") "}}")                                           \
    X("Mix",                                                                                       \
      "{'type':'object','minProperties':1,'maxProperties':1,'additionalProperties':false,"         \
      "'properties':{'weights':{'type':'object','additionalProperties':" OPENAPI_NUMBER "}"        \
      ",'embedding':{'type':'array','items':" OPENAPI_NUMBER "},'appearance':" OPENAPI_TEXT "}}")  \
    X("Steer",                                                                                     \
      "{'type':'object','description':'as Render, with the number that a client gives this "       \
      "camera, which the picture repeats; still: draw it in full at once; key: of a video, the "   \
      "next frame refers to no other',"                                                            \
      "'properties':{'number':" OPENAPI_INTEGER ",'still':{'type':'boolean'},"                     \
      "'key':{'type':'boolean'}}}")                                                                \
    X("Render",                                                                                    \
      "{'type':'object','additionalProperties':false,'description':'a camera, or a pose with "     \
      "width"                                                                                      \
      " and height','properties':{'camera':{'type':'object','description':'width, height, fx, fy," \
      " cx, cy in pixels and world_to_camera, row by row, from east-north-up metres about the"     \
      " origin of the dataset to x right, y down, z forward','required':['width','height','fx',"   \
      "'fy','cx','cy','world_to_camera'],'properties':{'width':" OPENAPI_INTEGER                   \
      ",'height':" OPENAPI_INTEGER ",'fx':" OPENAPI_NUMBER ",'fy':" OPENAPI_NUMBER                 \
      ",'cx':" OPENAPI_NUMBER ",'cy':" OPENAPI_NUMBER ",'world_to_camera':" OPENAPI_NUMBERS(       \
          16, 16) "}}"                                                                             \
                  ",'pose':{'type':'object','required':['lon','lat','height','heading','pitch'],'" \
                  "properties':{"                                                                  \
                  "'lon':" OPENAPI_NUMBER ",'lat':" OPENAPI_NUMBER ",'height':" OPENAPI_NUMBER     \
                  ",'heading':" OPENAPI_NUMBER ",'pitch':" OPENAPI_NUMBER ",'fov':" OPENAPI_NUMBER \
                  ",'roll':" OPENAPI_NUMBER "}},'width':" OPENAPI_INTEGER                          \
                  ",'height':" OPENAPI_INTEGER ",'format':{'type':'string','enum':['jpg','png','"  \
                  "webp','npy']},'depth':{'type':'string','enum':['mm','cm','dm','m']}"            \
                  ",'background':" OPENAPI_TEXT ",'quality':" OPENAPI_INTEGER                      \
                  ",'deadline_ms':" OPENAPI_INTEGER ",'supersample':" OPENAPI_INTEGER              \
                  ",'appearance':" OPENAPI_TEXT "}}")                                              \
    X("Places",                                                                                    \
      "{'type':'object','description':'places: up to 256 [longitude, latitude]; gsd_m'}")          \
    X("Pick",                                                                                      \
      "{'type':'object','description':'camera, or pose with width and height, as of Render;"       \
      " x, y in pixels'}")                                                                         \
    X("Profile", "{'type':'object','description':'line: 2 to 256 [longitude, latitude]; step_m'}") \
    X("Measure", "{'type':'object','description':'line, or polygon with base (rim, or a height in" \
                 " metres) and gsd_m'}")                                                           \
    X("Visible", "{'type':'object','description':'from, to: lon, lat, and height (ellipsoidal) or" \
                 " above (the surface)'}")                                                         \
    X("SeedLine",                                                                                  \
      "{'type':'object','properties':{'url':" OPENAPI_TEXT ",'etag':" OPENAPI_TEXT                 \
      ",'gaussians':" OPENAPI_INTEGER ",'bytes':" OPENAPI_INTEGER ",'next':" OPENAPI_TEXT "}}")    \
    X("State",                                                                                     \
      "{'type':'object','required':['status'],'properties':{'status':{'type':'string','enum':"     \
      "['ok','ready','degraded','empty']},'failed':{'type':'object','additionalProperties'"        \
      ":" OPENAPI_INTEGER "},'stores':{},'reload':" OPENAPI_TEXT ",'pictures':" OPENAPI_TEXT       \
      ",'memory':" OPENAPI_TEXT ",'help':" OPENAPI_TEXT "}}")                                      \
    X("Version",                                                                                   \
      "{'type':'object','required':['name','version','datasets','pictures'],'properties':{'name'"  \
      ":" OPENAPI_TEXT ",'version':" OPENAPI_TEXT ",'datasets':{'type':'object',"                  \
      "'additionalProperties':" OPENAPI_TEXT "},'pictures':{'type':'object','required':['state',"  \
      "'device'],'properties':{'state':" OPENAPI_TEXT ",'device':" OPENAPI_TEXT "}}}}")            \
    X("Token", "{'type':'object','required':['token'],'properties':{'token':" OPENAPI_TEXT "}}")   \
    X("Bytes", "{'type':'string','format':'binary'}")                                              \
    X("Text", OPENAPI_TEXT)                                                                        \
    X("Document", "{'type':'object'}")

#endif
