"""What is known about the files that exporters write: inputs, outputs and what they mean.

A table, no logic: `matching` holds a file against it. Names are those that the exporters give; a graph whose
tensors are called otherwise is told by ranks, number types and fixed sizes. Sources: Ultralytics exporter,
ibaiGorordo/ONNX-YOLO-World, AILab-CVC/YOLO-World `deploy/export_onnx.py`, samexporter and Meta's
`SamOnnxModel`, yformer/EfficientSAM, transformers.js exports, recognize-anything `onnx/export.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

Size = int | str | None


@dataclass(frozen=True, slots=True)
class Tensor:
    """One input or output. `role` is what adapters call it; `names` what exporters do, usual one first.

    `shape`: a number must be met wherever the graph fixes that size; a word is a size of the graph's own, the
    same wherever the word stands; None is anything. An optional tensor is found by name alone.
    """

    role: str
    names: tuple[str, ...]
    kind: str
    shape: tuple[Size, ...]
    optional: bool = False

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.names[0]} ({sizes})"


@dataclass(frozen=True, slots=True)
class Contract:
    """A kind of file. `use` is where it goes in the YAML, empty for files that nothing here can use.

    `extra` outputs may be there besides those named; `refusal` says what to do about a file that is known not
    to work. Shapes that differ only in meaning are told apart by `Contract.name` in `matching`.
    """

    name: str
    title: str
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    use: str = ""
    extra: bool = False
    refusal: str = ""

    def __str__(self) -> str:
        takes, gives = (", ".join(map(str, side)) for side in (self.inputs, self.outputs))
        return f"{self.title}: {takes} -> {gives}"


IMAGE = Tensor("image", ("images", "image", "input"), "float", (1, 3, "H", "W"))
BOXES_RAW = Tensor("output", ("output0", "output"), "float", (1, None, None))
EMBEDDING = Tensor("embedding", ("image_embeddings", "image_embedding"), "float", (1, "C", "h", "w"))
POSITIONS = Tensor("positions", ("image_positional_embeddings",), "float", (1, "C", "h", "w"))
PIXELS = Tensor("pixels", ("pixel_values",), "float", (None, 3, "S", "S"))
TOKENS = Tensor("tokens", ("input_ids",), "int", (None, "L"))
ATTENTION = Tensor("attention", ("attention_mask",), "int", (None, "L"), optional=True)

_WORLD = "detector: {use: yolo-world, model: FILE}"
_SEG = "detector: {use: yolo-seg, model: FILE}"
_SAM_ENCODER = "segmenter: {use: sam, encoder: FILE, decoder: ...}"
_SAM_DECODER = "segmenter: {use: sam, encoder: ..., decoder: FILE}"

CONTRACTS: tuple[Contract, ...] = (
    # (a) detectors
    Contract(
        "yolo",
        "Ultralytics export of YOLO-World or another YOLO",
        (IMAGE,),
        (BOXES_RAW,),
        _WORLD,
    ),
    Contract(
        "yolo-nms",
        "Ultralytics export with nms=True, or an end-to-end head",
        (IMAGE,),
        (Tensor("output", ("output0", "output"), "float", (1, "rows", 6)),),
        _WORLD,
    ),
    Contract(
        "yolo-world-text",
        "YOLO-World with the text features as an input",
        (IMAGE, Tensor("text", ("txt_feats", "text_feats", "text_features"), "float", (1, "N", "D"))),
        (BOXES_RAW,),
        "detector: {use: yolo-world, model: FILE, text: ..., tokenizer: ...}",
    ),
    Contract(
        "yolo-world-mmdet",
        "AILab-CVC export of YOLO-World with NMS",
        (IMAGE,),
        (
            Tensor("count", ("num_dets",), "int", (1, 1)),
            Tensor("boxes", ("boxes",), "float", (1, "rows", 4)),
            Tensor("scores", ("scores",), "float", (1, "rows")),
            Tensor("labels", ("labels",), "int", (1, "rows")),
        ),
        "detector: {use: yolo-world, model: FILE, classes: [...]}",
    ),
    Contract(
        "yolo-world-mmdet-raw",
        "AILab-CVC export of YOLO-World with --without-nms",
        (IMAGE,),
        (
            Tensor("scores", ("scores",), "float", (1, "anchors", "classes")),
            Tensor("boxes", ("boxes",), "float", (1, "anchors", 4)),
        ),
        "detector: {use: yolo-world, model: FILE, classes: [...]}",
    ),
    Contract(
        "yolo-world-maps",
        "raw feature maps of a YOLO head",
        (IMAGE,),
        (),
        extra=True,
        refusal="its boxes are not decoded; export it again without --model-only",
    ),
    Contract(
        "nanodet",
        "NanoDet as `dssmsg models get coco` makes it",
        (IMAGE,),
        tuple(
            Tensor(f"{part}_{stride}", (f"{part}_{stride}",), "float", (1, None, width))
            for stride in (8, 16, 32)
            for part, width in (("cls", 80), ("reg", 44))
        ),
        "detector: {use: coco}",
    ),
    # (b) detectors with masks
    Contract(
        "yolo-seg",
        "Ultralytics export of YOLOv8-seg, YOLO11-seg or YOLOE-seg",
        (IMAGE,),
        (BOXES_RAW, Tensor("prototypes", ("output1",), "float", (1, "K", None, None))),
        _SEG,
    ),
    Contract(
        "yolo-seg-nms",
        "Ultralytics export of a YOLO-seg model with nms=True",
        (IMAGE,),
        (
            Tensor("output", ("output0", "output"), "float", (1, "rows", None)),
            Tensor("prototypes", ("output1",), "float", (1, "K", None, None)),
        ),
        _SEG,
    ),
    # (c) the SAM family
    Contract(
        "sam-encoder-image",
        "SAM or MobileSAM image encoder with preprocessing inside",
        (Tensor("image", ("input_image", "image"), "float", (None, None, 3)),),
        (EMBEDDING,),
        _SAM_ENCODER,
        extra=True,
    ),
    Contract(
        "sam-encoder",
        "SAM or MobileSAM image encoder",
        (Tensor("image", ("input_image", "image", "images"), "float", (1, 3, "S", "S")),),
        (EMBEDDING,),
        _SAM_ENCODER,
    ),
    Contract(
        "sam-decoder",
        "SAM or MobileSAM mask decoder",
        (
            EMBEDDING,
            Tensor("points", ("point_coords",), "float", (1, None, 2)),
            Tensor("labels", ("point_labels",), "float", (1, None)),
            Tensor("mask", ("mask_input",), "float", (1, 1, None, None)),
            Tensor("has_mask", ("has_mask_input",), "float", (1,)),
            Tensor("size", ("orig_im_size",), "any", (2,)),
        ),
        (
            Tensor("low_masks", ("low_res_masks",), "float", (1, None, None, None)),
            Tensor("quality", ("iou_predictions",), "float", (1, None)),
        ),
        _SAM_DECODER,
        extra=True,
    ),
    Contract(
        "efficient-sam-encoder",
        "EfficientSAM image encoder",
        (Tensor("image", ("batched_images",), "float", (1, 3, "H", "W")),),
        (EMBEDDING,),
        _SAM_ENCODER,
    ),
    Contract(
        "efficient-sam-decoder",
        "EfficientSAM mask decoder",
        (
            EMBEDDING,
            Tensor("points", ("batched_point_coords",), "float", (1, "Q", "P", 2)),
            Tensor("labels", ("batched_point_labels",), "float", (1, "Q", "P")),
            Tensor("size", ("orig_im_size",), "int", (2,)),
        ),
        (
            Tensor("masks", ("output_masks",), "float", (1, None, None, None, None)),
            Tensor("quality", ("iou_predictions",), "float", (1, None, None)),
        ),
        _SAM_DECODER,
        extra=True,
    ),
    Contract(
        "efficient-sam",
        "EfficientSAM in one file",
        (
            Tensor("image", ("batched_images",), "float", (1, 3, "H", "W")),
            Tensor("points", ("batched_point_coords",), "float", (1, "Q", "P", 2)),
            Tensor("labels", ("batched_point_labels",), "float", (1, "Q", "P")),
        ),
        (
            Tensor("masks", ("output_masks",), "float", (1, None, None, None, None)),
            Tensor("quality", ("iou_predictions",), "float", (1, None, None)),
        ),
        "segmenter: {use: sam, encoder: FILE}",
        extra=True,
    ),
    Contract(
        "transformers-sam-encoder",
        "SAM image encoder in the transformers.js layout",
        (Tensor("image", ("pixel_values",), "float", (None, 3, "S", "S")),),
        (EMBEDDING, POSITIONS),
        _SAM_ENCODER,
    ),
    Contract(
        "transformers-sam-decoder",
        "SAM mask decoder in the transformers.js layout",
        (
            EMBEDDING,
            POSITIONS,
            Tensor("points", ("input_points",), "float", (None, "Q", "P", 2)),
            Tensor("labels", ("input_labels",), "int", (None, "Q", "P")),
        ),
        (
            Tensor("masks", ("pred_masks",), "float", (None, None, None, None, None)),
            Tensor("quality", ("iou_scores",), "float", (None, None, None)),
        ),
        _SAM_DECODER,
        extra=True,
    ),
    Contract(
        "sam2-encoder",
        "SAM 2 image encoder",
        (IMAGE,),
        (
            Tensor("high_0", ("high_res_feats_0",), "float", (1, None, None, None)),
            Tensor("high_1", ("high_res_feats_1",), "float", (1, None, None, None)),
            Tensor("embedding", ("image_embed",), "float", (1, None, None, None)),
        ),
        refusal="SAM 2 is not supported; take SAM, MobileSAM or EfficientSAM",
    ),
    # (d) CLIP
    Contract(
        "clip",
        "CLIP with both towers in one file",
        (TOKENS, PIXELS, ATTENTION),
        (
            Tensor("text", ("text_embeds",), "float", (None, "D")),
            Tensor("image", ("image_embeds",), "float", (None, "D")),
        ),
        "encoder: {use: clip, vision: FILE, text: FILE, tokenizer: ...}",
        extra=True,
    ),
    Contract(
        "clip-vision",
        "CLIP image tower",
        (PIXELS,),
        (Tensor("image", ("image_embeds", "image_embeddings", "pooler_output"), "float", (None, "D")),),
        "encoder: {use: clip, vision: FILE, text: ..., tokenizer: ...}",
        extra=True,
    ),
    Contract(
        "clip-text",
        "CLIP text tower",
        (TOKENS, ATTENTION),
        (Tensor("text", ("text_embeds", "text_embeddings", "pooler_output"), "float", (None, "D")),),
        "encoder: {use: clip, vision: ..., text: FILE, tokenizer: ...}",
        extra=True,
    ),
    Contract(
        "sentences",
        "sentence encoder of the BERT kind",
        (
            TOKENS,
            Tensor("attention", ("attention_mask",), "int", (None, "L")),
            Tensor("types", ("token_type_ids",), "int", (None, "L")),
        ),
        (Tensor("states", ("last_hidden_state",), "float", (None, "L", "D")),),
        extra=True,
        refusal="encoder: {use: minilm} brings its own files; no other sentence encoder can be configured",
    ),
    # (e) taggers
    Contract(
        "ram",
        "RAM or RAM++ tagger",
        (Tensor("image", ("image", "images", "input"), "float", (1, 3, "S", "S")),),
        (Tensor("tags", ("tag", "tags", "logits"), "float", (1, "T")),),
        "tagger: {use: ram, model: FILE, tags: ram_tag_list.txt}",
        extra=True,
    ),
)
"""Known files. Those that could be taken for each other are told apart by rules in `matching`."""


def contracts(*names: str) -> tuple[Contract, ...]:
    """The named contracts, in the order of the table."""
    return tuple(one for one in CONTRACTS if one.name in names)
